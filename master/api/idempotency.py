"""Cache of answers by `Idempotency-Key`: a request that is sent again because its answer was lost gets the same answer.

Failures of the server are not kept, so that they can be retried; everything else is kept for some hours.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import NamedTuple

from master.api.request import Answer, Call, Handler
from rce.errors import RceError
from rce.web.problems import KeyReused, status_of

HEADER = "Idempotency-Key"
UPLOAD_HEADERS = ("Upload-Length", "Upload-Metadata")
LIFETIME = 6 * 3600.0  # seconds
MAX_KEYS = 500  # of one credential; the oldest is evicted


class _Entry(NamedTuple):
    fingerprint: bytes
    created: float
    answer: asyncio.Task[Answer]


class IdempotencyCache:
    """Answers by the credential and the key of the request.

    `removals` has when users were removed: a later user of the same name gets no answer of the former one.
    """

    def __init__(self, removals: Callable[[], Mapping[str, float]] = dict) -> None:
        self._removals = removals
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
        credential = f"{call.user} {self._removals().get(call.user, 0.0)} {call.principal.key}"
        entries = self._entries.setdefault(credential, OrderedDict())
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
    """Return a digest of what a request asks for; headers of tus name and measure an upload."""
    asked = [call.method, call.target, *(f"{name}={call.header(name)}" for name in UPLOAD_HEADERS)]
    return hashlib.sha256(b"\0".join([*(each.encode() for each in asked), call.content])).digest()
