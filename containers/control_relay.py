"""Relay to the Master for environments without a network: a UNIX socket whose connections are forwarded."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import cast

from twisted.internet.base import ReactorBase
from twisted.internet.protocol import Factory, Protocol, connectionDone
from twisted.internet.tcp import Connection
from twisted.logger import Logger
from twisted.python.failure import Failure

from rce.control.client import addresses, client_endpoint
from rce.control.connection import disable_nagle
from rce.net.sockets import bind_unix_socket
from rce.net.tls import Tls

log = Logger()
SOCKET = "control.sock"
MAX_CONNECTIONS = 4  # an endpoint needs one, and a second one while the loss of the first is not yet noticed
MAX_EARLY = 1_000_000  # bytes received before the Master is connected


class _Client(asyncio.Protocol):
    """A connection from the environment; also the Twisted producer of what is sent to the Master."""

    def __init__(self, relay: ControlRelay) -> None:
        self.transport: asyncio.Transport
        self.lost = False
        self._early = b""  # data received before the Master was connected
        self._relay = relay
        self._onward: _Onward | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Connect to the Master, or close the connection if there are too many."""
        self.transport = cast(asyncio.Transport, transport)
        if not self._relay.add(self):
            self.transport.abort()
            return
        factory = Factory.forProtocol(lambda: _Onward(self))
        self._relay.master.connect(factory).addCallbacks(self._connected, self._unreachable)

    def data_received(self, data: bytes) -> None:
        """Send data to the Master, or keep it until the Master is connected."""
        if self._onward is not None:
            self._onward.transport.write(data)
        elif len(self._early) + len(data) <= MAX_EARLY:
            self._early += data
        else:
            self.transport.abort()

    def pause_writing(self) -> None:
        """Pause the Master's connection while the environment does not read."""
        if self._onward is not None:
            self._onward.transport.pauseProducing()

    def resume_writing(self) -> None:
        """Resume the Master's connection."""
        if self._onward is not None:
            self._onward.transport.resumeProducing()

    def connection_lost(self, exc: Exception | None) -> None:
        """Close the Master's connection too."""
        self.lost = True
        self._relay.discard(self)
        if self._onward is not None and not self._onward.lost:  # Twisted's TLS cannot be aborted twice
            self._onward.transport.abortConnection()

    def pauseProducing(self) -> None:
        """Stop reading while the Master does not read."""
        self.transport.pause_reading()

    def resumeProducing(self) -> None:
        """Read again."""
        self.transport.resume_reading()

    def stopProducing(self) -> None:
        """Close the connection, as the Master's is lost."""
        self.transport.abort()

    def _connected(self, onward: _Onward) -> None:
        if self.lost:
            onward.transport.abortConnection()
            return
        self._onward = onward
        onward.transport.registerProducer(self, True)
        onward.transport.write(self._early)

    def _unreachable(self, reason: Failure) -> None:
        log.info("the Master cannot be reached: {reason}", reason=reason.getErrorMessage())
        self.transport.abort()


class _Onward(Protocol):
    """The connection to the Master that belongs to a client."""

    transport: Connection  # type: ignore[assignment]  # or one that wraps it, for TLS

    def __init__(self, client: _Client) -> None:
        self.lost = False
        self._client = client

    def connectionMade(self) -> None:
        """Send each call at once."""
        disable_nagle(self.transport)

    def dataReceived(self, data: bytes) -> None:
        """Send data to the environment."""
        self._client.transport.write(data)

    def connectionLost(self, reason: Failure = connectionDone) -> None:
        """Close the environment's connection too."""
        self.lost = True
        self._client.transport.close()


class ControlRelay:
    """Accepts connections at `control.sock` in a directory and forwards them to a Twisted client endpoint.

    Of several Masters that is the first, until `lead` says which one leads. The Master authenticates and authorizes;
    the relay only limits the number of connections of its environment.
    """

    def __init__(self, reactor: ReactorBase, master: str, tls: Tls | None = None) -> None:
        self._reactor = reactor
        self._tls = tls
        self._address = addresses(master)[0]
        self.master = client_endpoint(reactor, self._address, tls)
        self._clients: set[_Client] = set()
        self._server: asyncio.Server | None = None

    async def open(self, directory: Path) -> None:
        """Start listening.

        Raises:
            OSError: The socket cannot be created.
        """
        listener = bind_unix_socket(directory / SOCKET, 0o666)  # for every user that can see the directory
        self._server = await asyncio.get_running_loop().create_unix_server(lambda: _Client(self), sock=listener)

    def lead(self, master: str) -> None:
        """Forward to this Master from now on, and close the connections to another one."""
        if master != self._address:
            self._address = master
            self.master = client_endpoint(self._reactor, master, self._tls)
            self._close_clients()

    def close(self) -> None:
        """Stop listening and close all connections."""
        if self._server is not None:
            self._server.close()
        self._close_clients()

    def _close_clients(self) -> None:
        for client in self._clients:
            client.transport.abort()

    def add(self, client: _Client) -> bool:
        """Count a client; return False if there are too many."""
        if len(self._clients) >= MAX_CONNECTIONS:
            return False
        self._clients.add(client)
        return True

    def discard(self, client: _Client) -> None:
        """Forget a client."""
        self._clients.discard(client)
