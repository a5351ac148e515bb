"""Perspective Broker as both sides of a control connection use it."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, cast

from twisted.internet.defer import Deferred
from twisted.internet.protocol import connectionDone
from twisted.logger import Logger
from twisted.python.failure import Failure
from twisted.spread import pb

from rce.control.decoder import INCOMPLETE, Decoder
from rce.control.limits import MAX_ITEMS, MAX_MESSAGE
from rce.control.messages import NO_KEYWORDS, encode_answer, encode_call, pages_of

log = Logger()


class Answerer(pb.Referenceable, ABC):
    """An object whose method `call` the peer calls with pages."""

    @abstractmethod
    def answer(self, pages: tuple[bytes, ...] | None) -> asyncio.Task[Sequence[bytes]]:
        """Begin to answer a call; return a task that returns the pages of the answer.

        Raises:
            Exception: The call is malformed; `pages` is None if it has something else.
        """


class PendingCall:
    """A call of ours that waits for its answer. Twisted's broker uses it like a Deferred, which takes more time."""

    def __init__(self) -> None:
        self.answer: asyncio.Future[tuple[bytes, ...]] = asyncio.get_running_loop().create_future()

    def callback(self, pages: tuple[bytes, ...]) -> None:
        """Pass the answer on, unless nobody waits any more."""
        if not self.answer.done():
            self.answer.set_result(pages)

    def errback(self, failure: Failure) -> None:
        """Pass an error on, unless nobody waits any more."""
        if not self.answer.done():
            self.answer.set_exception(cast(BaseException, failure.value))


class BaseBroker(pb.Broker):
    """Broker that answers pings, notices that something was received, and handles calls and answers itself.

    Twisted needs twice as many instructions for them. It handles the messages by which a process joins.

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

    def call(self, receiver: pb.RemoteReference, pages: Sequence[bytes]) -> asyncio.Future[tuple[bytes, ...]]:
        """Call an object of the peer; return a future that resolves to the answer.

        Raises:
            pb.DeadReferenceError: The connection is lost.
        """
        if self.disconnected:
            raise pb.DeadReferenceError("the connection is lost")
        transport: Any = self.transport
        request: int = self.newRequestID()  # type: ignore[no-untyped-call]
        self._waiting[request] = pending = PendingCall()
        transport.write(encode_call(request, receiver.luid, pages))
        return pending.answer

    def proto_message(
        self, requestID: int, objectID: Any, message: Any, answerRequired: Any, netArgs: Any, netKw: Any
    ) -> None:
        """Answer a call, and leave other messages to Twisted, such as those by which a peer joins.

        Raises:
            pb.Error: The id of the call is not a whole number from 0 on.
        """
        receiver = self.localObjectForID(objectID) if type(objectID) is int else None  # type: ignore[no-untyped-call]
        plain = message == b"call" and answerRequired == 1 and netKw == NO_KEYWORDS
        if not plain or not isinstance(receiver, Answerer):
            super().proto_message(requestID, objectID, message, answerRequired, netArgs, netKw)  # type: ignore[no-untyped-call]
            return
        if type(requestID) is not int or requestID < 0:
            raise pb.Error("the id of a call is malformed")
        try:
            answering = receiver.answer(pages_of(netArgs))
        except Exception as error:  # noqa: BLE001  # decoding raises many types
            wrong = pb.Error(f"malformed call: {type(error).__name__}")
            self._sendError(pb.CopyableFailure(wrong), requestID)  # type: ignore[no-untyped-call]
            return
        answering.add_done_callback(lambda done: self._send_answer(requestID, done))

    def _send_answer(self, request: int, answering: asyncio.Task[Sequence[bytes]]) -> None:
        if not answering.cancelled() and not self.disconnected:
            transport: Any = self.transport
            transport.write(encode_answer(request, answering.result()))

    def proto_answer(self, requestID: int, netResult: Any) -> None:
        """Pass on what the peer has answered.

        Raises:
            pb.Error: The answer to a call is malformed.
        """
        pending = self._waiting.pop(requestID)
        if not isinstance(pending, PendingCall):
            pending.callback(self.unserialize(netResult))  # type: ignore[no-untyped-call]
        elif (pages := pages_of(netResult)) is not None:
            pending.callback(pages)
        else:
            pending.errback(Failure(pb.PBConnectionLost("the answer is malformed")))
            raise pb.Error("the answer to a call is malformed")

    def proto_error(self, requestID: int, fail: Any) -> None:
        """Fail a call of ours; errors of handlers are results, so this one is of Perspective Broker itself."""
        self._waiting.pop(requestID).errback(Failure(pb.Error("the call was not understood")))

    @property
    def _waiting(self) -> dict[int, PendingCall | Deferred[Any]]:
        """The calls that wait for their answers; Twisted fails them when the connection is lost."""
        waiting: dict[int, PendingCall | Deferred[Any]] = self.waitingForAnswers  # type: ignore[assignment]  # None then
        return waiting

    def ping(self) -> None:
        """Ask the peer for a sign of life."""
        self.sendCall(b"ping")  # type: ignore[no-untyped-call]

    def proto_ping(self) -> None:
        """Answer a ping."""
        self.sendCall(b"pong")  # type: ignore[no-untyped-call]

    def proto_pong(self) -> None:
        """Take the answer to a ping: `heard` is all that counts."""
