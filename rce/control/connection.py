"""Control connections: typed two-way calls between processes, carried by Twisted's Perspective Broker.

Each process has one Referenceable per connection, and there is no object graph. A call is the name of its type and its
fields as msgpack (`rce.control.pages`). Errors cross as `ErrorInfo`. Each side notices a connection that broke silently
(`rce.control.liveness`).

`rce.control.server` accepts connections, `rce.control.client` opens them.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar, cast

import msgspec
from msgspec import Raw, Struct
from twisted.logger import Logger
from twisted.spread import pb
from twisted.spread.pb import RemoteError

from rce.control.base_broker import Answerer
from rce.control.calls.call import Call, Nothing, result_type
from rce.control.calls.watching import Metrics, ReadMetrics
from rce.control.limits import MAX_MESSAGE
from rce.control.liveness import Liveness
from rce.control.pages import MALFORMED_PAGES, Answer, Pages, Question, decode_pages, encode, encode_pages
from rce.control.term import Fence, Unfenced
from rce.errors import (
    MALFORMED,
    ErrorInfo,
    InternalError,
    InvalidRequest,
    Lost,
    RceError,
    TimedOut,
    clipped,
    disk_full,
)
from rce.process import logs, metrics

log = Logger()
_call_seconds = metrics.Timing("rce_control_call_seconds", "Time to answer a call of another process", "call")
R = TypeVar("R")


class Handlers:
    """The calls that this process answers: one coroutine function for each type of call."""

    def __init__(self) -> None:
        self._handlers: dict[str, tuple[type[Call[Any]], Callable[[Any], Awaitable[Struct]]]] = {}

    def on(self, kind: type[Call[R]], handler: Callable[[Any], Awaitable[R]]) -> None:
        """Answer calls of this type with `handler`."""
        self._handlers[kind.__name__] = kind, cast(Callable[[Any], Awaitable[Struct]], handler)

    def do(self, kind: type[Call[Nothing]], action: Callable[[Any], Awaitable[None] | None]) -> None:
        """Answer calls of this type, which have no result, with `action`, which may be a coroutine function."""

        async def handler(call: Call[Nothing]) -> Nothing:
            done = action(call)
            if done is not None:
                await done
            return Nothing()

        self.on(kind, handler)

    async def answer(self, question: Question, max_size: int = MAX_MESSAGE) -> Answer:
        """Run the handler of a call; return its result, or its error.

        Args:
            question: The call.
            max_size: Limit of the size of the answer.
        """
        name, request = question.name, question.request
        if request:
            logs.set_request_id(request)
        began = time.perf_counter()
        try:
            if name not in self._handlers:
                raise InvalidRequest(f"this process does not answer {name}")
            kind, handler = self._handlers[name]
            try:
                call = msgspec.msgpack.decode(question.call, type=kind)
            except MALFORMED as error:
                raise InvalidRequest(f"{name}: {error}") from None
            try:
                result = await handler(call)
            except OSError as error:
                raise disk_full(error) or error from None
            if request and isinstance(result, Nothing):  # calls with a result only read, and there may be many of them
                log.info("{call} is done in {seconds:.3f} s", call=name, seconds=time.perf_counter() - began)
            return Answer(True, encode(result, max_size))
        except RceError as error:
            if request:
                log.info("{call} failed: {error}", call=name[:80], error=str(error), code=error.info.code)
            metrics.errors.add("process", error.info.code)
            return Answer(False, encode(error.info))
        except Exception:  # noqa: BLE001  # the caller gets an InternalError, this process's log has the traceback
            log.failure("unhandled exception while answering {name}", name=name)
            metrics.errors.add("process", InternalError.code)
            return Answer(
                False, encode(InternalError(f"internal error while answering {name}: see the server's log").info)
            )
        finally:
            if name in self._handlers:  # an unknown name would become a metric label of the peer's choice
                _call_seconds.labels(name).observe_since(began)

    def serve_metrics(self, role: str, *sources: metrics.Source) -> None:
        """Answer `ReadMetrics` with the metrics of this process and of `sources`."""

        async def read(_: ReadMetrics) -> Metrics:
            return Metrics(metrics.collect_families(role, *sources))

        self.on(ReadMetrics, read)


class Receiver(pb.Referenceable):
    """An object that the peer can reach. A malformed call of its methods is the peer's fault, so it is not logged."""

    def remoteMessageReceived(self, broker: pb.Broker, message: str, args: Any, kw: Any) -> Any:
        """Call a method.

        Raises:
            pb.Error: The method or the arguments do not exist.
        """
        try:
            return super().remoteMessageReceived(broker, message, args, kw)  # type: ignore[no-untyped-call]
        except Exception as error:  # noqa: BLE001  # Twisted raises many types, and would log them with tracebacks
            raise pb.Error(f"malformed call: {type(error).__name__}") from None


class CallReceiver(Receiver, Answerer):
    """The only object that a joined peer needs: it passes the peer's calls to `handlers`."""

    def __init__(self, handlers: Handlers, max_size: int = MAX_MESSAGE, fence: Fence | None = None) -> None:
        """Create a receiver; `max_size` is the limit of the size of an answer, and `fence` refuses calls."""
        self.handlers = handlers
        self._max_size = max_size
        self._fence = fence or Unfenced()

    def answer(self, pages: tuple[bytes, ...] | None) -> asyncio.Task[Pages]:
        """Begin to answer a call of the peer; see `Handlers.answer`."""
        return asyncio.create_task(self._answer(decode_pages(pages or (), Question)))

    async def _answer(self, question: Question) -> Pages:
        try:
            self._fence.check(question.term)
        except RceError as error:
            return encode_pages(Answer(False, encode(error.info)))
        return encode_pages(await self.handlers.answer(question, self._max_size))


class Control:
    """One joined control connection, used to call the peer.

    Attributes:
        address: The peer's address, for messages.
        lost: Done when the connection is gone.
        fell_silent: True if it was given up because nothing came any more: the peer, or only the line, may be dead.
    """

    def __init__(
        self,
        receiver: pb.RemoteReference,
        address: str,
        max_size: int = MAX_MESSAGE,
        pings: bool = False,
        fence: Fence | None = None,
    ) -> None:
        """Use a joined connection, until it is silent.

        Args:
            receiver: The peer's CallReceiver.
            address: The peer's address.
            max_size: Limit of the size of a call.
            pings: This side sends the pings.
            fence: Has the term that is sent with each call.
        """
        self.address = address
        self.fell_silent = False
        self._max_size = max_size
        self._fence = fence or Unfenced()
        self.lost: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._receiver = receiver
        self._liveness = Liveness(receiver.broker, pings, self._end_silent)
        receiver.notifyOnDisconnect(self._disconnected)

    async def call(self, call: Call[R], seconds: float = 0.0) -> R:
        """Call the peer and return its answer.

        Args:
            call: The call.
            seconds: Time for the answer; 0 for that of the type of the call.

        Raises:
            Lost: The connection broke before the answer came.
            TimedOut: The answer did not come in time.
            LimitExceeded: The call is too large.
            RceError: The peer answered with this error.
        """
        name, seconds = type(call).__name__, seconds or call.timeout
        try:
            answer = self._call_remote(name, encode(call, self._max_size))
            timer = asyncio.get_running_loop().call_later(seconds, _time_out, answer)
            try:
                pages = await answer
            finally:
                timer.cancel()
        except TimeoutError:
            raise TimedOut(f"{self.address} did not answer {name} within {seconds:g} s") from None
        except (pb.DeadReferenceError, pb.PBConnectionLost):
            raise Lost(f"the control connection to {self.address} was lost during {name}") from None
        except (pb.Error, RemoteError, ValueError) as wrong:
            raise InvalidRequest(f"{self.address} did not understand {name}: {wrong}") from None
        try:
            found = decode_pages(pages, Answer)
            if found.good:
                return msgspec.msgpack.decode(found.value, type=result_type(type(call)))
            error = RceError.from_info(clipped(msgspec.msgpack.decode(found.value, type=ErrorInfo)))
        except MALFORMED_PAGES as wrong:
            error = InvalidRequest(f"{self.address} answered {name} with something else: {wrong}")
        raise error

    def _call_remote(self, name: str, call: Raw) -> asyncio.Future[tuple[bytes, ...]]:
        pages = encode_pages(Question(name, logs.request_id.get(), self._fence.term, call))
        answer: asyncio.Future[tuple[bytes, ...]] = self._receiver.broker.call(self._receiver, pages)
        return answer

    def close(self) -> None:
        """Close the connection at once."""
        abort(self._receiver.broker)

    def _disconnected(self, _: object) -> None:
        self._liveness.stop()
        if not self.lost.done():
            self.lost.set_result(None)

    def _end_silent(self) -> None:
        log.warn("nothing was received from {address}: closing the control connection", address=self.address)
        self.fell_silent = True
        self.close()


def _time_out(answer: asyncio.Future[tuple[bytes, ...]]) -> None:
    if not answer.done():
        answer.set_exception(TimeoutError())


def disable_nagle(transport: Any) -> None:
    """Disable Nagle's algorithm on a Twisted transport, if that is TCP: each call is sent at once."""
    if getattr(transport.getPeer(), "type", "") == "TCP":
        transport.setTcpNoDelay(True)


def abort(broker: pb.Broker) -> None:
    """Abort the connection of a Perspective Broker, if it is still open."""
    if broker.transport is not None and not broker.disconnected:  # Twisted's TLS cannot be aborted twice
        broker.transport.abortConnection()
