"""Control connections between processes: typed two-way calls carried by Twisted's Perspective Broker.

One Referenceable per process and direction, no object graph: a call is the name of its type and its fields as msgpack,
in pages because PB refuses strings over 640 KiB. Errors cross as `ErrorInfo`. Both sides ping, so that a connection
which died silently is noticed by both.
"""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Awaitable, Callable
from typing import Any, Protocol, TypeVar, cast

import msgspec
from msgspec import Struct
from twisted.internet import endpoints
from twisted.internet.base import ReactorBase
from twisted.internet.defer import Deferred
from twisted.internet.error import ConnectionLost
from twisted.internet.interfaces import IListeningPort
from twisted.logger import Logger
from twisted.python.failure import Failure
from twisted.spread import pb

from rce import logs, metrics
from rce.broker import Broker
from rce.calls.call import Call, Nothing, Ping, result_type
from rce.calls.joining import Hello, Welcome
from rce.calls.watching import Metrics, ReadMetrics
from rce.errors import ErrorInfo, InternalError, InvalidRequest, Lost, RceError, Unavailable
from rce.tls import Tls

PAGE = 500_000
PING_EVERY = 5.0
PING_TIMEOUT = 10.0
JOIN_TIMEOUT = 10.0
BACKOFF_FIRST = 0.05
BACKOFF_MOST = 1.0  # a Master that is back is found again within this time

log = Logger()
_TCP = re.compile(r"tcp:(?:host=)?((?:[^:\\]|\\.)*)")
_answering = metrics.Timing("rce_control_call_seconds", "Time to answer a call of another process", "call")
R = TypeVar("R")
C = TypeVar("C", bound=Call[Any])
Pages = list[bytes]


def _pages(value: Struct) -> Pages:
    data = msgspec.msgpack.encode(value)
    return [data[start : start + PAGE] for start in range(0, len(data), PAGE)]


def _value(pages: Pages, kind: type[R]) -> R:
    return msgspec.msgpack.decode(b"".join(pages), type=kind)


class Handlers:
    """What this process answers: one coroutine function for each type of call."""

    def __init__(self) -> None:
        self._handlers: dict[str, tuple[type[Call[Any]], Callable[[Any], Awaitable[Struct]]]] = {}
        self.on(Ping, _pong)

    def on(self, kind: type[Call[R]], handler: Callable[[Any], Awaitable[R]]) -> None:
        self._handlers[kind.__name__] = kind, cast(Callable[[Any], Awaitable[Struct]], handler)

    def do(self, kind: type[Call[Nothing]], action: Callable[[Any], Awaitable[None] | None]) -> None:
        """For a call that only does something."""

        async def handler(call: Call[Nothing]) -> Nothing:
            done = action(call)
            if done is not None:
                await done
            return Nothing()

        self.on(kind, handler)

    async def answer(self, name: str, pages: Pages, request: str = "") -> tuple[bool, Pages]:
        """Whether it went well, and the result or the ErrorInfo. `request`: on whose behalf, for the log."""
        if request:
            logs.enter(request)
        began = time.perf_counter()
        try:
            if name not in self._handlers:
                raise InvalidRequest(f"this process does not answer {name}")
            kind, handler = self._handlers[name]
            try:
                call = _value(pages, kind)
            except (msgspec.DecodeError, TypeError) as error:
                raise InvalidRequest(f"{name}: {error}") from None
            result = await handler(call)
            if request and isinstance(result, Nothing):  # others are questions, of which there may be many
                log.info("{call} is done in {seconds:.3f} s", call=name, seconds=time.perf_counter() - began)
            return True, _pages(result)
        except RceError as error:
            if request:
                log.info("{call} was refused: {error}", call=name[:80], error=str(error), code=error.info.code)
            metrics.errors.add("process", error.info.code)
            return False, _pages(error.info)
        except Exception:  # noqa: BLE001  # the caller must hear of a defect here; the traceback stays in this process's log
            log.failure("defect while answering {name}", name=name)
            metrics.errors.add("process", InternalError.code)
            return False, _pages(InternalError(f"a defect while answering {name}; see the server's log").info)
        finally:
            if name in self._handlers:  # any other name may be anything
                _answering.of(name).since(began)

    def tell_metrics(self, role: str, *sources: metrics.Source) -> None:
        """Answer for the metrics of this process, and for these of its parts."""

        async def read(_: ReadMetrics) -> Metrics:
            return Metrics(metrics.families(role, *sources))

        self.on(ReadMetrics, read)


async def _pong(_: Ping) -> Nothing:
    return Nothing()


class _Door(pb.Referenceable):
    """Our side's only remote object: takes the other side's calls."""

    def __init__(self, handlers: Handlers) -> None:
        self.handlers = handlers

    def remote_call(self, name: str, pages: Pages, request: str = "") -> Deferred[tuple[bool, Pages]]:
        return Deferred.fromFuture(asyncio.ensure_future(self.handlers.answer(name, pages, request)))


class Control:
    """The other side of one control connection."""

    def __init__(self, door: pb.RemoteReference, address: str) -> None:
        self.address = address
        self.lost: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._door = door
        self._pinger = asyncio.create_task(self._ping())
        door.notifyOnDisconnect(self._gone)

    async def call(self, call: Call[R]) -> R:
        """Raises what the other side raised, or Lost when it is gone."""
        name = type(call).__name__
        try:
            deferred = self._door.callRemote("call", name, _pages(call), logs.request.get())
            good, pages = await deferred.asFuture(asyncio.get_running_loop())
        except (pb.DeadReferenceError, pb.PBConnectionLost):
            raise Lost(f"the control connection to {self.address} was lost during {name}") from None
        try:
            if good:
                return _value(pages, result_type(type(call)))
            error = RceError.from_info(_value(pages, ErrorInfo))
        except (msgspec.DecodeError, TypeError) as wrong:
            error = InvalidRequest(f"{self.address} answered {name} with something else: {wrong}")
        raise error

    def close(self) -> None:
        _abort(self._door.broker)

    def _gone(self, _: object) -> None:
        self._pinger.cancel()
        if not self.lost.done():
            self.lost.set_result(None)

    async def _ping(self) -> None:
        while True:
            await asyncio.sleep(PING_EVERY)
            try:
                await asyncio.wait_for(self.call(Ping()), PING_TIMEOUT)
            except (TimeoutError, Unavailable):
                log.warn(
                    "no answer from {address} for {seconds} s: closing", address=self.address, seconds=PING_TIMEOUT
                )
                self.close()
                return


class Joiner(Protocol):
    """Decides whether a process may join; returns its credential and what this side answers it."""

    async def join(self, hello: Hello, address: str) -> tuple[Welcome, Handlers, Callable[[Control], None]]: ...


class _Root(pb.Root):
    """What a process that is not yet known may call: `join`."""

    def __init__(self, joiner: Joiner) -> None:
        self.joiner = joiner
        self.broker: Broker | None = None

    def rootObject(self, broker: Broker) -> _Root:
        entrance = _Root(self.joiner)  # one a connection: it knows who is calling
        entrance.broker = broker
        return entrance

    def remote_join(self, pages: Pages, door: pb.RemoteReference) -> Deferred[tuple[bool, Pages, _Door | None]]:
        return Deferred.fromFuture(asyncio.ensure_future(self._join(pages, door)))

    def _address(self) -> str:
        transport = self.broker.transport if self.broker else None
        peer = transport.getPeer() if transport else None  # type: ignore[misc]  # zope declares it without self
        return f"{getattr(peer, 'host', 'local')}:{getattr(peer, 'port', 0)}"

    async def _join(self, pages: Pages, door: pb.RemoteReference) -> tuple[bool, Pages, _Door | None]:
        address = self._address()
        try:
            try:
                hello = _value(pages, Hello)
            except (msgspec.DecodeError, TypeError) as error:
                raise InvalidRequest(f"join: {error}") from None
            welcome, handlers, joined = await self.joiner.join(hello, address)
        except RceError as error:
            return False, _pages(error.info), None
        if self.broker is not None:
            self.broker.joined = True
        # After the answer is on its way, so that the other side knows its door before the first call comes in.
        asyncio.get_running_loop().call_soon(lambda: joined(Control(door, address)))
        return True, _pages(welcome), _Door(handlers)


def server_endpoint(reactor: ReactorBase, description: str) -> Any:  # zope declares its methods without self
    """What a setting describes, an IStreamServerEndpoint of Twisted's. InvalidRequest."""
    try:
        return endpoints.serverFromString(reactor, description)
    except (ValueError, TypeError) as error:
        raise InvalidRequest(
            f"{description!r} is no Twisted server endpoint such as tcp:9000 or tcp:9000:interface=127.0.0.1: {error}"
        ) from None


async def listen(reactor: ReactorBase, description: str, joiner: Joiner, tls: Tls | None = None) -> IListeningPort:
    """Take control connections at a Twisted server endpoint (`tcp:8080:interface=127.0.0.1`). InvalidRequest."""
    endpoint = server_endpoint(reactor, description)
    factory = pb.PBServerFactory(_Root(joiner))
    factory.protocol = Broker
    port: IListeningPort = await endpoint.listen(_taking(tls, factory)).asFuture(asyncio.get_running_loop())
    return port


async def connect(
    reactor: ReactorBase, description: str, hello: Hello, handlers: Handlers, tls: Tls | None = None
) -> tuple[Control, Welcome]:
    """Join the Master at a Twisted client endpoint (`tcp:host:8080`, `unix:/path`).

    Raises Unavailable when it cannot be reached, and what the Master says when it refuses.
    """
    loop = asyncio.get_running_loop()
    factory = pb.PBClientFactory()
    broker: pb.Broker | None = None
    try:
        async with asyncio.timeout(JOIN_TIMEOUT):
            broker = await client_endpoint(reactor, description, tls).connect(factory).asFuture(loop)
            root = await _root(factory, broker).asFuture(loop)
            good, pages, door = await root.callRemote("join", _pages(hello), _Door(handlers)).asFuture(loop)
    except BaseException as error:  # each transport has its own classes for this
        if broker is not None:
            _abort(broker)
        if not isinstance(error, Exception):
            raise
        reason = f"no answer within {JOIN_TIMEOUT:g} s" if isinstance(error, TimeoutError) else str(error)
        raise Unavailable(f"the Master at {description} cannot be reached: {reason}") from None
    if not good:
        factory.disconnect()
        raise RceError.from_info(_value(pages, ErrorInfo))
    return Control(door, description), _value(pages, Welcome)


def _abort(broker: pb.Broker) -> None:
    if broker.transport is not None and not broker.disconnected:  # Twisted's TLS cannot be aborted twice
        broker.transport.abortConnection()


def client_endpoint(reactor: ReactorBase, description: str, tls: Tls | None) -> Any:
    """A Twisted client endpoint; with `tls`, one that is described as `tcp:` is wrapped in it."""
    endpoint = endpoints.clientFromString(reactor, description)
    found = _TCP.match(description)
    if tls is None or found is None:
        return endpoint
    from rce.control_tls import dialling  # images of environments lack what it needs

    return dialling(tls, re.sub(r"\\(.)", r"\1", found[1]), endpoint)


def _taking(tls: Tls | None, factory: pb.PBServerFactory) -> Any:
    if tls is None:
        return factory
    from rce.control_tls import taking  # as above

    return taking(tls, factory)


def _root(factory: pb.PBClientFactory, broker: pb.Broker) -> Deferred[pb.RemoteReference]:
    """The other side's root; fails when the connection is lost first, of which endpoints do not tell the factory."""
    deferred: Deferred[pb.RemoteReference] = factory.getRootObject()
    broker.notifyOnDisconnect(lambda: factory.clientConnectionLost(None, Failure(ConnectionLost())))
    if broker.disconnected:
        factory.clientConnectionLost(None, Failure(ConnectionLost()))
    return deferred


class MasterLink:
    """A process's connection to the Master, made again whenever it is lost; calls wait while it is away."""

    def __init__(
        self,
        reactor: ReactorBase,
        description: str,
        hello: Callable[[], Hello],
        handlers: Handlers,
        welcomed: Callable[[Welcome], None],
        tls: Tls | None = None,
    ) -> None:
        self._tls = tls
        self._reactor = reactor
        self._description = description
        self._hello = hello
        self._handlers = handlers
        self._welcomed = welcomed
        self._control: asyncio.Future[Control] = asyncio.get_running_loop().create_future()

    async def run(self) -> None:
        """Keep the connection; returns only by the error with which the Master refuses this process."""
        pause = BACKOFF_FIRST
        while True:
            try:
                control, welcome = await connect(
                    self._reactor, self._description, self._hello(), self._handlers, self._tls
                )
            except Unavailable as error:
                log.info("{error}; next try in {pause} s", error=str(error), pause=pause)
                await asyncio.sleep(pause)
                pause = min(2 * pause, BACKOFF_MOST)
                continue
            pause = BACKOFF_FIRST
            try:
                self._welcomed(welcome)
                self._control.set_result(control)
                await control.lost
            finally:
                control.close()
            self._control = asyncio.get_running_loop().create_future()

    async def issue(self, call: Call[R], wait: float = 10.0) -> asyncio.Task[R]:
        """Send a call to the Master and return its coming answer; calls arrive in the order of their issue.

        While the Master is away, wait for it up to `wait` seconds, then Unavailable.
        """
        if not self._control.done():
            await asyncio.wait([self._control], timeout=wait)
            if not self._control.done():
                raise Unavailable(f"the Master has been away for {wait:g} s; try again later")
        return asyncio.create_task(self._control.result().call(call))

    async def call(self, call: Call[R], wait: float = 10.0) -> R:
        """Ask the Master; while it is away, wait for it up to `wait` seconds, then Unavailable."""
        return await (await self.issue(call, wait))

    @property
    def connected(self) -> bool:
        return self._control.done()
