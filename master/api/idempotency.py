"""Cache of answers by `Idempotency-Key`: a request that is sent again because its answer was lost gets the same answer.

Failures of the server are not kept, so that they can be retried; everything else is kept for some hours.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections import OrderedDict
from typing import NamedTuple

from master.api.request import Answer, Call, Handler
from rce.errors import RceError
from rce.web.problems import KeyReused, status_of

HEADER = "Idempotency-Key"
LIFETIME = 6 * 3600.0  # seconds
MAX_KEYS = 500  # of one credential; the oldest is evicted


class _Entry(NamedTuple):
    fingerprint: bytes
    created: float
    answer: asyncio.Task[Answer]


class IdempotencyCache:
    """Answers by the credential and the key of the request."""

    def __init__(self) -> None:
        self._entries: dict[str, OrderedDict[str, _Entry]] = {}

    async def answer(self, call: Call, handler: Handler) -> Answer:
        """Return the handler's answer, or the one that it gave to an earlier request with this key.

        A request with a key goes on when its client disconnects.

        Raises:
            KeyReused: The key was used for another request.
        """
        key = call.header(HEADER)
        if key is None or call.principal is None:
            return await handler(call)
        return await asyncio.shield(self._find(call, key, handler))

    def _find(self, call: Call, key: str, handler: Handler) -> asyncio.Task[Answer]:
        assert call.principal is not None
        now = asyncio.get_running_loop().time()
        self._evict(now - LIFETIME)
        entries = self._entries.setdefault(f"{call.user} {call.principal.key}", OrderedDict())
        present, fingerprint = entries.get(key), _fingerprint(call)
        if present is None:
            task = asyncio.ensure_future(handler(call))
            task.add_done_callback(lambda _: self._ended(entries, key, task))
            present = entries[key] = _Entry(fingerprint, now, task)
            if len(entries) > MAX_KEYS:
                entries.popitem(last=False)
        elif present.fingerprint != fingerprint:
            raise KeyReused(f"{HEADER} {key[:80]!r} was used for another request", field=HEADER)
        return present.answer

    def _ended(self, entries: OrderedDict[str, _Entry], key: str, task: asyncio.Task[Answer]) -> None:
        error = None if task.cancelled() else task.exception()
        final = not task.cancelled() and (error is None or (isinstance(error, RceError) and status_of(error) < 500))
        if not final and key in entries and entries[key].answer is task:
            del entries[key]

    def _evict(self, before: float) -> None:
        for entries in self._entries.values():
            while entries and next(iter(entries.values())).created < before:
                entries.popitem(last=False)
        self._entries = {credential: entries for credential, entries in self._entries.items() if entries}


def _fingerprint(call: Call) -> bytes:
    return hashlib.sha256(b"\0".join([call.method.encode(), call.target.encode(), call.content])).digest()
