"""Answers that go on (server-sent events), until the client leaves or its credentials are void."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator
from typing import NamedTuple

import msgspec
from msgspec import Struct
from twisted.web.server import Request

from master.guard import Guard
from master.rights import Principal
from rce.errors import LimitExceeded, RceError

KIND = "text/event-stream"
BEAT = 15.0  # seconds after which something is sent in any case, so that nobody on the way takes it for dead
MOST = 20  # streams of one user


class Piece(NamedTuple):
    """One event: `name` may be empty."""

    id: str
    name: str
    data: Struct


class Streams:
    """Those that are open."""

    def __init__(self, guard: Guard) -> None:
        self._guard = guard
        self._open: Counter[str] = Counter()

    def stream(self, principal: Principal, pieces: AsyncIterator[Piece]) -> Stream:
        """LimitExceeded."""
        if self._open[principal.user] >= MOST:
            raise LimitExceeded(f"{principal.user} has {MOST} streams open already", limit=MOST)
        return Stream(self._guard, self._open, principal, pieces)


class Stream:
    """One answer, and a push producer of Twisted's: nothing more is asked for while there is no room."""

    def __init__(self, guard: Guard, count: Counter[str], principal: Principal, pieces: AsyncIterator[Piece]) -> None:
        self._guard = guard
        self._count = count
        self._principal = principal
        self._pieces = pieces
        self._room = asyncio.Event()

    async def run(self, request: Request) -> None:
        """Until one of them is done with it; cancelled when the client has left."""
        request.setHeader("content-type", KIND)
        request.setHeader("cache-control", "no-store")
        if request.method == b"HEAD":
            request.finish()
            return
        sending = asyncio.ensure_future(self._send(request))

        def close(reason: str) -> None:
            sending.cancel()

        release = self._guard.hold(self._principal, close)
        self._count[self._principal.user] += 1
        request.registerProducer(self, True)
        try:
            await asyncio.wait([sending])
        finally:
            sending.cancel()
            release()
            self._count[self._principal.user] -= 1
        request.unregisterProducer()
        request.finish()
        if not sending.cancelled():
            sending.result()

    async def _send(self, request: Request) -> None:
        self._room.set()
        self._beat(request)
        try:
            async for piece in self._pieces:
                await self._room.wait()
                request.write(_text(piece))
        except RceError as error:
            request.write(_text(Piece("", "error", error.info)))
        finally:
            self._timer.cancel()

    def _beat(self, request: Request) -> None:
        """Also the first thing that is sent: the client knows that it is heard."""
        self._timer = asyncio.get_running_loop().call_later(BEAT, self._beat, request)
        if self._room.is_set():
            request.write(b":\n\n")

    def pauseProducing(self) -> None:
        self._room.clear()

    def resumeProducing(self) -> None:
        self._room.set()

    def stopProducing(self) -> None:
        self._room.clear()


def _text(piece: Piece) -> bytes:
    head = (f"id: {piece.id}\n" if piece.id else "") + (f"event: {piece.name}\n" if piece.name else "")
    return head.encode() + b"data: " + msgspec.json.encode(piece.data) + b"\n\n"
