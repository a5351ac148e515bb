"""The listening side of control connections: TLS, limits for unjoined peers, and the join handshake."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, Protocol

from msgspec.structs import replace
from twisted.internet import endpoints
from twisted.internet.base import ReactorBase
from twisted.internet.defer import Deferred
from twisted.internet.interfaces import IListeningPort
from twisted.logger import Logger
from twisted.spread import pb

from rce.control.broker import Broker
from rce.control.calls.joining import Hello, Welcome
from rce.control.connection import CallReceiver, Control, Handlers, Receiver
from rce.control.limits import Budgets, max_message
from rce.control.pages import MALFORMED_PAGES, Pages, decode_pages, encode_pages
from rce.control.term import Fence, Unfenced
from rce.errors import InternalError, InvalidRequest, RceError
from rce.net.listener import BACKLOG
from rce.net.tls import Tls

log = Logger()


class Joiner(Protocol):
    """The authority that admits processes."""

    async def join(self, hello: Hello, address: str) -> tuple[Welcome, Handlers, Callable[[Control], None]]:
        """Authenticate a process.

        Args:
            hello: What the process says of itself.
            address: Its network address.

        Returns:
            Its credential, the handlers for its calls, and a function that is called with the joined connection.

        Raises:
            RceError: The process is refused.
        """


class _Root(Receiver, pb.Root):
    """The object that an unjoined peer can reach; its only method is `join`, which can be called once."""

    def __init__(self, joiner: Joiner, budgets: Budgets, fence: Fence) -> None:
        self.joiner = joiner
        self.budgets = budgets
        self.fence = fence
        self.broker: Broker | None = None
        self._called = False

    def rootObject(self, broker: Broker) -> _Root:
        root = _Root(self.joiner, self.budgets, self.fence)  # one for each connection, whose limits depend on who joins
        root.broker = broker
        return root

    def remote_join(
        self, pages: Pages, receiver: pb.RemoteReference
    ) -> Deferred[tuple[bool, Pages, CallReceiver | None]]:
        if self.broker is not None:
            self.broker.stop_timeout()
        return Deferred.fromFuture(asyncio.ensure_future(self._join(pages, receiver)))

    def _address(self) -> str:
        transport = self.broker.transport if self.broker else None
        peer = transport.getPeer() if transport else None  # type: ignore[misc]  # zope declares it without self
        return f"{getattr(peer, 'host', 'local')}:{getattr(peer, 'port', 0)}"

    async def _join(self, pages: Pages, receiver: pb.RemoteReference) -> tuple[bool, Pages, CallReceiver | None]:
        address = self._address()
        try:
            hello = self._hello(pages, receiver)
            welcome, handlers, joined = await self.joiner.join(hello, address)
            self.fence.check(hello.term)
        except RceError as error:
            return False, encode_pages(error.info), None
        except Exception:  # noqa: BLE001  # the peer gets an InternalError, the log has the traceback
            log.failure("unhandled exception while {address} joined", address=address)
            return False, encode_pages(InternalError("internal error while joining: see the server's log").info), None
        budget = self.budgets.of(hello)
        if budget is not None:
            await asyncio.sleep(budget.join(hello.name))
        if self.broker is not None:
            self.broker.admit(max_message(hello.role), budget)
        # Only after the answer is on its way, so that the peer has our CallReceiver before our first call arrives.
        asyncio.get_running_loop().call_soon(lambda: joined(Control(receiver, address, fence=self.fence)))
        return True, encode_pages(replace(welcome, term=self.fence.term)), CallReceiver(handlers, fence=self.fence)

    def _hello(self, pages: Pages, receiver: object) -> Hello:
        """Decode the arguments of `join`.

        Raises:
            InvalidRequest: They are malformed, or `join` was called before.
        """
        if self._called or not isinstance(receiver, pb.RemoteReference):
            raise InvalidRequest("join: it is called once in a connection, with the receiver of calls")
        self._called = True
        try:
            hello = decode_pages(pages, Hello)
        except MALFORMED_PAGES as error:
            raise InvalidRequest(f"join: {error}") from None
        if not (hello.name + hello.role + hello.version).isprintable():
            raise InvalidRequest("join: the name, role or version has control characters")
        return hello


def _server_endpoint(reactor: ReactorBase, description: str) -> Any:  # zope declares its methods without self
    """Parse a Twisted server endpoint, such as `tcp:9000:interface=127.0.0.1`; return an IStreamServerEndpoint.

    Raises:
        InvalidRequest: The description is malformed.
    """
    try:
        takes_backlog = description.startswith(("tcp:", "ssl:", "unix:")) and ":backlog=" not in description
        return endpoints.serverFromString(reactor, description + f":backlog={BACKLOG}" * takes_backlog)
    except (ValueError, TypeError) as error:
        raise InvalidRequest(
            f"{description!r} is not a Twisted server endpoint, as tcp:9000 or tcp:9000:interface=127.0.0.1: {error}"
        ) from None


async def listen(
    reactor: ReactorBase, description: str, joiner: Joiner, tls: Tls | None = None, fence: Fence | None = None
) -> IListeningPort:
    """Accept control connections at a Twisted server endpoint.

    `fence` refuses greetings and calls, and has the term that is sent with them.

    Raises:
        InvalidRequest: The description is malformed.
    """
    endpoint = _server_endpoint(reactor, description)
    factory = pb.PBServerFactory(_Root(joiner, Budgets(), fence or Unfenced()))
    factory.protocol = Broker
    port: IListeningPort = await endpoint.listen(_with_tls(tls, factory)).asFuture(asyncio.get_running_loop())
    return port


def _with_tls(tls: Tls | None, factory: pb.PBServerFactory) -> Any:
    if tls is None:
        return factory
    from rce.control.tls import wrap_server_factory  # needs pyOpenSSL, which environment images do not have

    return wrap_server_factory(tls, factory)
