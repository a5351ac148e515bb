"""Requests that are made again because their answer was lost: the same `Idempotency-Key` gets the same answer.

What failed on our side is forgotten, so that it may be tried again; everything else is kept for some hours.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections import OrderedDict
from typing import NamedTuple

from master.api.calls import Answer, Call, Handler
from master.api.problems import KeyReused, status_of
from rce.errors import RceError

HEADER = "Idempotency-Key"
KEPT = 6 * 3600.0  # seconds
MOST = 500  # of one credential; the oldest goes first


class _Request(NamedTuple):
    fingerprint: bytes
    made: float
    answer: asyncio.Task[Answer]


class Repeats:
    """Requests by who made them, and by their keys."""

    def __init__(self) -> None:
        self._made: dict[str, OrderedDict[str, _Request]] = {}

    async def answer(self, call: Call, handler: Handler) -> Answer:
        """What the handler answers, now or at the first time. Once begun it goes on, also when nobody waits for it."""
        key = call.header(HEADER)
        if key is None or call.principal is None:
            return await handler(call)
        return await asyncio.shield(self._find(call, key, handler))

    def _find(self, call: Call, key: str, handler: Handler) -> asyncio.Task[Answer]:
        assert call.principal is not None
        now = asyncio.get_running_loop().time()
        self._forget(now - KEPT)
        made = self._made.setdefault(f"{call.user} {call.principal.key}", OrderedDict())
        present, fingerprint = made.get(key), _fingerprint(call)
        if present is None:
            task = asyncio.ensure_future(handler(call))
            task.add_done_callback(lambda _: self._ended(made, key, task))
            present = made[key] = _Request(fingerprint, now, task)
            if len(made) > MOST:
                made.popitem(last=False)
        elif present.fingerprint != fingerprint:
            raise KeyReused(f"{HEADER} {key[:80]!r} was used for another request", field=HEADER)
        return present.answer

    def _ended(self, made: OrderedDict[str, _Request], key: str, task: asyncio.Task[Answer]) -> None:
        error = None if task.cancelled() else task.exception()
        final = not task.cancelled() and (error is None or (isinstance(error, RceError) and status_of(error) < 500))
        if not final and key in made and made[key].answer is task:
            del made[key]

    def _forget(self, before: float) -> None:
        for made in self._made.values():
            while made and next(iter(made.values())).made < before:
                made.popitem(last=False)
        self._made = {who: made for who, made in self._made.items() if made}


def _fingerprint(call: Call) -> bytes:
    body: bytes = call.content.read()
    call.content.seek(0)
    return hashlib.sha256(b"\0".join([call.request.method, call.request.uri, body])).digest()
