"""Perspective Broker with limits for unjoined peers and for the size of a message.

Twisted's decoder limits each string and the length of each list, but neither the nesting depth of lists nor the total
size of a message. It copies the rest of its buffer for each item, and never closes a silent connection. So any peer
that reaches the port, which programs in an environment do through the relay, could exhaust memory and processor time.
"""

from __future__ import annotations

import asyncio
from typing import Any

from twisted.logger import Logger
from twisted.python.failure import Failure
from twisted.spread import pb

from rce.process.logs import RateLimitedLogger

# Limits for a peer that has not joined:
MAX_UNJOINED_BYTES = 4 * 1024 * 1024  # the Hello of a Robot endpoint names all of its robots
MAX_UNJOINED_ITEMS = 100  # strings, numbers and lists; each page of a Hello is one item
UNJOINED_SLICE = 4096  # bytes that are decoded at a time
JOIN_TIMEOUT = 20.0  # seconds
# Limits for all peers:
MAX_MESSAGE_BYTES = 256 * 1024 * 1024
MAX_DEPTH = 32  # nested lists

log = Logger()
unjoined_log = RateLimitedLogger(log)


class Broker(pb.Broker):
    """Broker of one connection. `rce.control.server` sets `joined` once it has admitted the peer."""

    joined = False

    def connectionMade(self) -> None:
        """Start the timeout for joining."""
        super().connectionMade()  # type: ignore[no-untyped-call]  # Twisted's, as are those below
        self._size = 0  # bytes since the last complete message; before joining, since the start of the connection
        self._items = 0
        self._ended = False
        self._timer = asyncio.get_running_loop().call_later(JOIN_TIMEOUT, self._join_timed_out)

    def connectionLost(self, reason: Failure) -> None:  # type: ignore[override]  # Twisted always passes it
        """Stop the timeout."""
        self._timer.cancel()
        super().connectionLost(reason)  # type: ignore[no-untyped-call]

    def dataReceived(self, data: bytes) -> None:
        """Decode received bytes within the limits."""
        while data and not self._ended:
            count = len(data) if self.joined else UNJOINED_SLICE
            self._decode(data[:count])
            data = data[count:]

    def _decode(self, data: bytes) -> None:
        self._size += len(data)
        if self._size > (MAX_MESSAGE_BYTES if self.joined else MAX_UNJOINED_BYTES):
            self._refuse("a message is too large" if self.joined else "it sent too much before joining")
            return
        try:
            super().dataReceived(data)  # type: ignore[no-untyped-call]
        except Exception as error:  # noqa: BLE001  # the decoder raises many types for malformed data
            self._refuse(f"malformed data: {str(error)[:100] or type(error).__name__}")
            return
        if len(self.listStack) > MAX_DEPTH:
            self._refuse("lists are nested too deeply")

    def gotItem(self, item: Any) -> None:
        """Process a decoded item; Banana calls this."""
        self._items += 1
        if not self.joined and self._items > MAX_UNJOINED_ITEMS:
            raise pb.Error("too many items before joining")
        if self.joined and not self.listStack:
            self._size = 0  # a message is complete; the data at hand may have further ones
        super().gotItem(item)  # type: ignore[no-untyped-call]

    def _join_timed_out(self) -> None:
        if not self.joined:
            self._refuse(f"it did not join within {JOIN_TIMEOUT:g} s")

    def _refuse(self, reason: str) -> None:
        if self._ended:
            return
        self._ended = True
        self.listStack.clear()
        transport: Any = self.transport
        peer = transport.getPeer()
        address = f"{getattr(peer, 'host', 'local')}:{getattr(peer, 'port', 0)}"
        warnings = log if self.joined else unjoined_log
        warnings.warn("closing the control connection from {address}: {reason}", address=address, reason=reason)
        transport.abortConnection()
