"""Perspective Broker with bounds: what a connection may say before it has joined, and how large one message may be.

Twisted's own decoder bounds each string and the length of each list, but neither how deep lists lie in each other nor
how much there is of them; it copies what is left of its buffer for each item, and keeps a connection that says nothing
for ever. Whoever reaches the port (from within an environment too, by its relay) could take all memory and time.
"""

from __future__ import annotations

import asyncio
from typing import Any

from twisted.logger import Logger
from twisted.python.failure import Failure
from twisted.spread import pb

from rce.logs import Sparing

HELLO_MOST = 4 * 1024 * 1024  # bytes until one has joined: a Robot endpoint names all of its robots
HELLO_ITEMS = 100  # strings, numbers and lists until then; a page of a Hello is one
HELLO_SLICE = 4096  # bytes that are decoded at a stretch until then
MESSAGE_MOST = 256 * 1024 * 1024  # bytes of one message
DEPTH = 32  # lists in lists
JOIN_WITHIN = 20.0  # seconds

log = Logger()
strangers = Sparing(log)


class Broker(pb.Broker):
    """One connection; `joined` is set by who lets it in."""

    joined = False

    def connectionMade(self) -> None:
        super().connectionMade()  # type: ignore[no-untyped-call]  # Twisted's, as are those below
        self._size = 0  # bytes since the last whole message, or since the beginning until one has joined
        self._items = 0
        self._ended = False
        self._timer = asyncio.get_running_loop().call_later(JOIN_WITHIN, self._too_late)

    def connectionLost(self, reason: Failure) -> None:  # type: ignore[override]  # Twisted gives it always
        self._timer.cancel()
        super().connectionLost(reason)  # type: ignore[no-untyped-call]

    def dataReceived(self, data: bytes) -> None:
        while data and not self._ended:
            count = len(data) if self.joined else HELLO_SLICE
            self._take(data[:count])
            data = data[count:]

    def _take(self, data: bytes) -> None:
        self._size += len(data)
        if self._size > (MESSAGE_MOST if self.joined else HELLO_MOST):
            self._refuse("it says too much")
            return
        try:
            super().dataReceived(data)  # type: ignore[no-untyped-call]
        except Exception as error:  # noqa: BLE001  # the decoder has no class of its own for what it does not take
            self._refuse(f"it cannot be understood: {str(error)[:100] or type(error).__name__}")
            return
        if len(self.listStack) > DEPTH:
            self._refuse("it has lists too deep in each other")

    def gotItem(self, item: Any) -> None:
        """Banana's, for each thing that it has read."""
        self._items += 1
        if not self.joined and self._items > HELLO_ITEMS:
            raise pb.Error("too many things before it has joined")
        if self.joined and not self.listStack:
            self._size = 0  # a message is whole; the next ones may be in what is read already
        super().gotItem(item)  # type: ignore[no-untyped-call]

    def _too_late(self) -> None:
        if not self.joined:
            self._refuse(f"it has not joined within {JOIN_WITHIN:g} s")

    def _refuse(self, reason: str) -> None:
        if self._ended:
            return
        self._ended = True
        self.listStack.clear()
        transport: Any = self.transport
        peer = transport.getPeer()
        address = f"{getattr(peer, 'host', 'local')}:{getattr(peer, 'port', 0)}"
        refused = log if self.joined else strangers
        refused.warn("the control connection from {address} is closed: {reason}", address=address, reason=reason)
        transport.abortConnection()
