"""The connecting side of control connections: TLS, the join handshake, and reconnection with backoff.

A process may know several Masters, of which one leads. It asks all of them at once, and joins the one that welcomes it.
"""

from __future__ import annotations

import asyncio
import random
import re
from collections.abc import Callable
from typing import Any, TypeVar

from msgspec.structs import replace
from twisted.internet import endpoints
from twisted.internet.base import ReactorBase
from twisted.internet.defer import Deferred
from twisted.internet.error import ConnectionLost
from twisted.logger import Logger
from twisted.python.failure import Failure
from twisted.spread import pb

from rce.control.base_broker import BaseBroker
from rce.control.calls.call import Call
from rce.control.calls.joining import Hello, Welcome
from rce.control.connection import CallReceiver, Control, Handlers, abort, disable_nagle
from rce.control.limits import max_message
from rce.control.pages import decode_pages, encode_pages
from rce.control.term import Fence, KnownTerm, Unfenced
from rce.errors import ErrorInfo, InvalidRequest, RceError, Unavailable
from rce.net.tls import Tls

CONNECT_TIMEOUT = 10.0  # seconds
# Seconds. After a restart of the Master 10,000 processes wait in its queue for half a minute: whoever gave up and asked
# again would make the queue longer.
JOIN_TIMEOUT = 60.0
PATIENCE = 15.0  # seconds for which a call waits for a connection: a standby takes over meanwhile
BACKOFF_MIN = 0.05
BACKOFF_MAX = 1.0  # short, so that all processes find a restarted Master within a second

log = Logger()
R = TypeVar("R")
_TCP = re.compile(r"tcp:(?:host=)?((?:[^:\\]|\\.)*)")


def addresses(masters: str) -> list[str]:
    """Return the Twisted client endpoints in a setting with those of one or more Masters, separated by commas.

    Raises:
        InvalidRequest: There is none.
    """
    found = [each.strip() for each in masters.split(",") if each.strip()]
    if not found:
        raise InvalidRequest("setting master: give the control address of the Master, as tcp:HOST:8080", field="master")
    return found


async def connect(
    reactor: ReactorBase,
    description: str,
    hello: Hello,
    handlers: Handlers,
    tls: Tls | None = None,
    fence: Fence | None = None,
) -> tuple[Control, Welcome]:
    """Connect and join the Master at a Twisted client endpoint (`tcp:host:8080`, `unix:/path`).

    `fence` refuses Masters and calls, and has the term that is sent with them.

    Raises:
        Unavailable: The Master cannot be reached or does not answer in time.
        RceError: The Master refuses this process.
    """
    loop = asyncio.get_running_loop()
    factory = pb.PBClientFactory()
    factory.protocol = BaseBroker
    fence = fence or Unfenced()
    broker: pb.Broker | None = None
    limit = CONNECT_TIMEOUT
    try:
        async with asyncio.timeout(limit):
            broker = await client_endpoint(reactor, description, tls).connect(factory).asFuture(loop)
        disable_nagle(broker.transport)
        limit = JOIN_TIMEOUT
        async with asyncio.timeout(limit):
            root = await _get_root(factory, broker).asFuture(loop)
            own = CallReceiver(handlers, max_message(hello.role), fence)
            good, pages, receiver = await root.callRemote("join", encode_pages(hello), own).asFuture(loop)
    except BaseException as error:  # each transport has its own classes for this
        if broker is not None:
            abort(broker)
        if not isinstance(error, Exception):
            raise
        reason = f"no answer within {limit:g} s" if isinstance(error, TimeoutError) else str(error)
        if tls is not None and isinstance(error, ConnectionLost):
            reason += (
                " If this goes on, it refuses the certificate of this machine, because that has expired or is of "
                "another authority, or because the machine was removed"
            )
        raise Unavailable(f"the Master at {description} cannot be reached: {reason}") from None
    if not good:
        factory.disconnect()
        raise RceError.from_info(decode_pages(pages, ErrorInfo))
    welcome = decode_pages(pages, Welcome)
    try:
        fence.check(welcome.term)
    except RceError:
        factory.disconnect()
        raise
    return Control(receiver, description, max_message(hello.role), pings=True, fence=fence), welcome


def client_endpoint(reactor: ReactorBase, description: str, tls: Tls | None) -> Any:
    """Parse a Twisted client endpoint; with `tls`, wrap a `tcp:` endpoint in TLS."""
    endpoint = endpoints.clientFromString(reactor, description)
    found = _TCP.match(description)
    if tls is None or found is None:
        return endpoint
    from rce.control.tls import wrap_client_endpoint  # needs pyOpenSSL, which environment images do not have

    return wrap_client_endpoint(tls, re.sub(r"\\(.)", r"\1", found[1]), endpoint)


def _get_root(factory: pb.PBClientFactory, broker: pb.Broker) -> Deferred[pb.RemoteReference]:
    """Return the peer's root object; fails if the connection is lost first.

    Twisted's endpoints do not tell the factory of the loss, so this function does.
    """
    deferred: Deferred[pb.RemoteReference] = factory.getRootObject()
    broker.notifyOnDisconnect(lambda: factory.clientConnectionLost(None, Failure(ConnectionLost())))
    if broker.disconnected:
        factory.clientConnectionLost(None, Failure(ConnectionLost()))
    return deferred


def _close_unused(attempt: asyncio.Task[tuple[Control, Welcome]]) -> None:
    """Close the connection of an attempt that was given up when it had succeeded."""
    if not attempt.cancelled() and attempt.exception() is None:
        attempt.result()[0].close()


class ControlClient:
    """A process's connection to the Master, which reconnects whenever it is lost; calls wait in the meantime.

    Attributes:
        master: Twisted client endpoint of the Master that this process joined last.
    """

    def __init__(
        self,
        reactor: ReactorBase,
        description: str,
        hello: Callable[[], Hello],
        handlers: Handlers,
        welcomed: Callable[[Welcome], None],
        tls: Tls | None = None,
    ) -> None:
        """Prepare a client, which connects in `run`.

        Args:
            reactor: Twisted's reactor.
            description: The Master's Twisted client endpoint; those of several Masters are separated by commas.
            hello: Makes the Hello of each join, with the present state of this process.
            handlers: Handlers for the Master's calls.
            welcomed: Called with the Master's answer after each join.
            tls: Certificates of this machine.
        """
        self._tls = tls
        self._reactor = reactor
        self._masters = addresses(description)
        self._fence = KnownTerm()
        self.master = self._masters[0]
        self._hello = hello
        self._handlers = handlers
        self._welcomed = welcomed
        self._control: asyncio.Future[Control] = asyncio.get_running_loop().create_future()

    async def run(self) -> None:
        """Connect, and reconnect until cancelled.

        Raises:
            RceError: The Master refuses this process.
        """
        while True:
            control, welcome = await self._join()
            try:
                self._welcomed(welcome)
                self._control.set_result(control)
                await control.lost
            finally:
                control.close()
            self._control = asyncio.get_running_loop().create_future()

    async def _join(self) -> tuple[Control, Welcome]:
        """Ask all Masters until one welcomes this process: one that does not lead refuses it, or does not answer."""
        attempts = {asyncio.create_task(self._join_one(master)) for master in self._masters}
        chosen = None
        try:
            done, _ = await asyncio.wait(attempts, return_when=asyncio.FIRST_COMPLETED)
            chosen = done.pop()
            control, welcome = chosen.result()
        finally:
            for attempt in attempts - {chosen}:
                attempt.cancel()
                attempt.add_done_callback(_close_unused)
        self.master = control.address
        return control, welcome

    async def _join_one(self, master: str) -> tuple[Control, Welcome]:
        """Ask a Master until it welcomes this process.

        Raises:
            RceError: It refuses this process.
        """
        delay = BACKOFF_MIN
        while True:
            hello = replace(self._hello(), term=self._fence.term)
            try:
                return await connect(self._reactor, master, hello, self._handlers, self._tls, self._fence)
            except Unavailable as error:
                pause = random.uniform(delay / 2, delay)  # not all processes at the same moment
                log.info("{error}; next attempt in {pause:.2f} s", error=str(error), pause=pause)
            await asyncio.sleep(pause)
            delay = min(2 * delay, BACKOFF_MAX)

    async def issue(self, call: Call[R], wait: float = PATIENCE) -> asyncio.Task[R]:
        """Send a call to the Master and return a task for its answer; calls arrive in the order of their issue.

        Raises:
            Unavailable: The connection was not back within `wait` seconds.
        """
        if not self._control.done():
            await asyncio.wait([self._control], timeout=wait)
            if not self._control.done():
                raise Unavailable(f"no connection to the Master for {wait:g} s: try again later")
        return asyncio.create_task(self._control.result().call(call))

    async def call(self, call: Call[R], wait: float = PATIENCE) -> R:
        """Call the Master and return its answer.

        Raises:
            Unavailable: The connection was not back within `wait` seconds.
            Lost: The connection broke before the answer came.
            RceError: The Master answered with this error.
        """
        return await (await self.issue(call, wait))

    @property
    def connected(self) -> bool:
        """True while this process is joined."""
        return self._control.done()
