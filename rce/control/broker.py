"""Perspective Broker with limits for what peers send.

Any peer that reaches the port, which programs in an environment do through the relay, could otherwise exhaust memory
and processor time. What an unjoined peer may send is limited in total; `rce.control.limits` has what a joined one may
send. Received messages are handled in slices, so that a burst of one peer does not delay the others.
"""

from __future__ import annotations

import asyncio
from typing import Any, ClassVar

from twisted.internet.protocol import connectionDone
from twisted.logger import Logger
from twisted.python.failure import Failure
from twisted.spread import pb

from rce.control.base_broker import BaseBroker
from rce.control.connection import disable_nagle
from rce.control.decoder import INCOMPLETE
from rce.control.limits import BYTES_PER_CALL, MAX_ITEMS, Budget
from rce.control.messages import NO_KEYWORDS
from rce.process.logs import RateLimitedLogger

# Limits for a peer that has not joined:
MAX_UNJOINED_BYTES = 4 * 1024 * 1024  # the Hello of a Robot endpoint names all of its robots
MAX_UNJOINED_ITEMS = 100  # strings, numbers and lists; each page of a Hello is one item
JOIN_TIMEOUT = 20.0  # seconds until a peer asks to join

# Types of values that peers may send, besides bytes and numbers. They join with a reference to the receiver of calls.
_PLAIN = frozenset({b"None", b"boolean", b"list", b"tuple", b"unicode"})
_REFERENCE = b"remote"
_COMMANDS = frozenset({b"version", b"message", b"answer", b"error", b"decref", b"ping"})  # that we use

log = Logger()
warnings = RateLimitedLogger(log)


class Broker(BaseBroker):
    """Broker of one connection. `rce.control.server` calls `admit` once the peer has joined."""

    joined = False
    slice_size: ClassVar[int] = 32

    def connectionMade(self) -> None:
        """Start the timeout for joining."""
        disable_nagle(self.transport)
        self._budget: Budget | None = None
        self._next_ping = 0.0  # when a ping is free again
        self._timer = asyncio.get_running_loop().call_later(JOIN_TIMEOUT, self._join_timed_out)
        super().connectionMade()
        self._decoder.max_bytes, self._decoder.max_items = MAX_UNJOINED_BYTES, MAX_UNJOINED_ITEMS

    def connectionLost(self, reason: Failure = connectionDone) -> None:
        """Stop the timers."""
        self._timer.cancel()
        if self._budget is not None:
            self._budget.connections -= 1
        super().connectionLost(reason)

    def stop_timeout(self) -> None:
        """Stop the timeout of a peer that has asked to join; when many do, it may be long until all are answered."""
        self._timer.cancel()

    def admit(self, max_message: int, budget: Budget | None) -> None:
        """Set the limits of a peer that has joined."""
        self.joined = True
        self._budget = None if self._ended else budget
        if self._budget is not None:
            self._budget.connections += 1
        self._decoder.max_bytes, self._decoder.max_items = max_message, MAX_ITEMS

    # --- receiving ----------------------------------------------------------------------------------------------------

    def _handle_messages(self) -> None:
        """Handle messages within the limits, and pause after a slice of them."""
        for _ in range(self.slice_size):
            try:
                message = self._decoder.next()
                if message is INCOMPLETE:
                    return
                wait = self._count(message)
                self.callExpressionReceived(message)  # type: ignore[no-untyped-call]
            except Exception as error:  # noqa: BLE001  # Perspective Broker raises many types for malformed messages
                self._refuse(f"malformed data: {str(error)[:100] or type(error).__name__}")
                return
            if self._ended:
                return
            if wait:
                self._pause(wait)
                return
        self._pause(0.0)

    def _count(self, message: object) -> float:
        """Count a message; return the seconds to wait before the next one."""
        decoder = self._decoder
        if not self.joined:
            decoder.max_bytes -= decoder.size
            decoder.max_items -= decoder.items
            return 0.0
        if self._budget is None:
            return 0.0
        return self._budget.use((0 if self._is_free(message) else 1) + decoder.size / BYTES_PER_CALL)

    def _is_free(self, message: object) -> bool:
        """Return True for an answer to a call of ours, and for a ping if the last one was a second ago."""
        kind = message[:1] if isinstance(message, list) else []
        if kind != [b"ping"]:
            return kind == [b"answer"]
        now = asyncio.get_running_loop().time()
        if now < self._next_ping:
            return False
        self._next_ping = now + 1
        return True

    def expressionReceived(self, sexp: Any) -> None:
        """Handle a message.

        Raises:
            pb.Error: It is none of those that control connections use.
        """
        if not isinstance(sexp, list) or not sexp or sexp[0] not in _COMMANDS:
            raise pb.Error("it is neither a call nor an answer")
        if sexp[0] == b"message" and not isinstance(sexp[2], bytes | int):
            raise pb.Error("the name of an object has another type")  # Twisted would log the TypeError
        super().expressionReceived(sexp)  # type: ignore[no-untyped-call]

    def unserialize(self, sexp: Any, perspective: Any = None) -> Any:
        """Return the value of a part of a message.

        Raises:
            pb.Error: It has more than plain values. Twisted would make objects of some classes, even half of one.
        """
        parts = [sexp]
        while parts:
            part = parts.pop()
            if not isinstance(part, list) or part == NO_KEYWORDS:
                continue
            if part[0] == _REFERENCE and [type(each) for each in part[1:]] == [int]:
                continue
            if part[0] not in _PLAIN:
                raise pb.Error("a value has another type")
            parts += part[1:]
        return super().unserialize(sexp, perspective)  # type: ignore[no-untyped-call]

    def proto_ping(self) -> None:
        """Answer a ping of a peer that has joined.

        Raises:
            pb.Error: It has not joined.
        """
        if not self.joined:
            raise pb.Error("it pings before it has joined")
        super().proto_ping()

    # --- end ----------------------------------------------------------------------------------------------------------

    def _join_timed_out(self) -> None:
        if not self.joined:
            self._refuse(f"it did not join within {JOIN_TIMEOUT:g} s")

    def _refuse(self, reason: str) -> None:
        if self._ended:
            return
        self._ended = True
        transport: Any = self.transport
        peer = transport.getPeer()
        address = f"{getattr(peer, 'host', 'local')}:{getattr(peer, 'port', 0)}"
        warnings.warn("closing the control connection from {address}: {reason}", address=address, reason=reason)
        transport.abortConnection()
