"""The listening side of control connections: TLS, limits for unjoined peers, and the join handshake."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, Protocol

import msgspec
from twisted.internet import endpoints
from twisted.internet.base import ReactorBase
from twisted.internet.defer import Deferred
from twisted.internet.interfaces import IListeningPort
from twisted.spread import pb

from rce.control.broker import Broker
from rce.control.calls.joining import Hello, Welcome
from rce.control.connection import CallReceiver, Control, Handlers, Pages, decode_pages, encode_pages
from rce.errors import InvalidRequest, RceError
from rce.net.tls import Tls


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


class _Root(pb.Root):
    """The object that an unjoined peer can reach; its only method is `join`."""

    def __init__(self, joiner: Joiner) -> None:
        self.joiner = joiner
        self.broker: Broker | None = None

    def rootObject(self, broker: Broker) -> _Root:
        root = _Root(self.joiner)  # one for each connection, since `join` marks the connection of its caller
        root.broker = broker
        return root

    def remote_join(
        self, pages: Pages, receiver: pb.RemoteReference
    ) -> Deferred[tuple[bool, Pages, CallReceiver | None]]:
        return Deferred.fromFuture(asyncio.ensure_future(self._join(pages, receiver)))

    def _address(self) -> str:
        transport = self.broker.transport if self.broker else None
        peer = transport.getPeer() if transport else None  # type: ignore[misc]  # zope declares it without self
        return f"{getattr(peer, 'host', 'local')}:{getattr(peer, 'port', 0)}"

    async def _join(self, pages: Pages, receiver: pb.RemoteReference) -> tuple[bool, Pages, CallReceiver | None]:
        address = self._address()
        try:
            try:
                hello = decode_pages(pages, Hello)
            except (msgspec.DecodeError, TypeError) as error:
                raise InvalidRequest(f"join: {error}") from None
            welcome, handlers, joined = await self.joiner.join(hello, address)
        except RceError as error:
            return False, encode_pages(error.info), None
        if self.broker is not None:
            self.broker.joined = True
        # Only after the answer is on its way, so that the peer has our CallReceiver before our first call arrives.
        asyncio.get_running_loop().call_soon(lambda: joined(Control(receiver, address)))
        return True, encode_pages(welcome), CallReceiver(handlers)


def _server_endpoint(reactor: ReactorBase, description: str) -> Any:  # zope declares its methods without self
    """Parse a Twisted server endpoint, such as `tcp:9000:interface=127.0.0.1`; return an IStreamServerEndpoint.

    Raises:
        InvalidRequest: The description is malformed.
    """
    try:
        return endpoints.serverFromString(reactor, description)
    except (ValueError, TypeError) as error:
        raise InvalidRequest(
            f"{description!r} is not a Twisted server endpoint, as tcp:9000 or tcp:9000:interface=127.0.0.1: {error}"
        ) from None


async def listen(reactor: ReactorBase, description: str, joiner: Joiner, tls: Tls | None = None) -> IListeningPort:
    """Accept control connections at a Twisted server endpoint.

    Raises:
        InvalidRequest: The description is malformed.
    """
    endpoint = _server_endpoint(reactor, description)
    factory = pb.PBServerFactory(_Root(joiner))
    factory.protocol = Broker
    port: IListeningPort = await endpoint.listen(_with_tls(tls, factory)).asFuture(asyncio.get_running_loop())
    return port


def _with_tls(tls: Tls | None, factory: pb.PBServerFactory) -> Any:
    if tls is None:
        return factory
    from rce.control.tls import wrap_server_factory  # needs pyOpenSSL, which environment images do not have

    return wrap_server_factory(tls, factory)
