"""Perspective Broker as both sides of a control connection use it."""

from __future__ import annotations

import asyncio
from typing import Any, ClassVar

from twisted.internet.defer import Deferred
from twisted.internet.protocol import connectionDone
from twisted.logger import Logger
from twisted.python.failure import Failure
from twisted.spread import pb

from rce.control.decoder import INCOMPLETE, Decoder
from rce.control.limits import MAX_ITEMS, MAX_MESSAGE

log = Logger()


class BaseBroker(pb.Broker):
    """Broker that answers pings, notices that something was received, and takes little time for calls and answers.

    Attributes:
        heard: Something was received since this was set to False.
        slice_size: Number of messages that are handled before others, such as robots, get a turn.
    """

    heard = False
    slice_size: ClassVar[int] = 4

    def connectionMade(self) -> None:
        """Begin to decode."""
        self._decoder = Decoder(MAX_MESSAGE, MAX_ITEMS)
        self._ended = False
        self._paused: asyncio.TimerHandle | None = None
        super().connectionMade()  # type: ignore[no-untyped-call]  # Twisted's, as are those below

    def connectionLost(self, reason: Failure = connectionDone) -> None:
        """Handle no more messages."""
        self._ended = True
        if self._paused is not None:
            self._paused.cancel()
        super().connectionLost(reason)  # type: ignore[no-untyped-call]

    # --- receiving ----------------------------------------------------------------------------------------------------

    def dataReceived(self, data: bytes) -> None:
        """Note and handle received bytes."""
        if self._ended:
            return
        self.heard = True
        self._decoder.feed(data)
        if self._paused is None:
            self._handle_messages()

    def _handle_messages(self) -> None:
        """Handle messages, and pause after a slice of them."""
        for _ in range(self.slice_size):
            message = self._decoder.next()
            if message is INCOMPLETE:
                return
            self.callExpressionReceived(message)  # type: ignore[no-untyped-call]
        self._pause(0.0)

    def _pause(self, seconds: float) -> None:
        transport: Any = self.transport
        transport.pauseProducing()
        self._paused = asyncio.get_running_loop().call_later(seconds, self._resume)

    def _resume(self) -> None:
        self._paused = None
        transport: Any = self.transport
        try:
            self._handle_messages()
        except Exception:  # noqa: BLE001  # Perspective Broker raises many types for malformed messages
            log.failure("malformed data on a control connection, which is closed")  # as by what `dataReceived` raises
            transport.abortConnection()
            return
        if self._paused is None and not self._ended:
            transport.resumeProducing()

    # --- messages -----------------------------------------------------------------------------------------------------

    def serialize(self, object: Any, *more: Any, **options: Any) -> Any:
        """Return the form of a value for the line; Twisted takes long for those of which calls and answers consist."""
        if type(object) is tuple and all(type(each) is bytes for each in object):
            return [b"tuple", *object]
        if type(object) is dict and not object:
            return [b"dictionary"]
        return super().serialize(object, *more, **options)  # type: ignore[no-untyped-call]

    def unserialize(self, sexp: Any, perspective: Any = None) -> Any:
        """Return the value of a part of a message."""
        if type(sexp) is list and sexp and sexp[0] == b"tuple" and all(type(each) is bytes for each in sexp):
            return tuple(sexp[1:])
        if sexp == [b"dictionary"]:
            return {}
        return super().unserialize(sexp, perspective)  # type: ignore[no-untyped-call]

    def proto_error(self, requestID: int, fail: Any) -> None:
        """Fail a call of ours; errors of handlers are results, so this one is of Perspective Broker itself."""
        self._end_call(requestID).errback(Failure(pb.Error("the call was not understood")))

    def _end_call(self, request: int) -> Deferred[Any]:
        waiting: dict[int, Deferred[Any]] = self.waitingForAnswers  # type: ignore[assignment]  # None without a connection
        return waiting.pop(request)

    def ping(self) -> None:
        """Ask the peer for a sign of life."""
        self.sendCall(b"ping")  # type: ignore[no-untyped-call]

    def proto_ping(self) -> None:
        """Answer a ping."""
        self.sendCall(b"pong")  # type: ignore[no-untyped-call]

    def proto_pong(self) -> None:
        """Take the answer to a ping: `heard` is all that counts."""
