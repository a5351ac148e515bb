"""The way from a walled-in environment to the Master: a UNIX socket whose visitors are passed on to it."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import cast

from twisted.internet.base import ReactorBase
from twisted.internet.protocol import Factory, Protocol, connectionDone
from twisted.internet.tcp import Connection
from twisted.logger import Logger
from twisted.python.failure import Failure

from rce.control import client_endpoint
from rce.sockets import bound
from rce.tls import Tls

log = Logger()
SOCKET = "control.sock"
VISITORS = 4  # at once: an endpoint needs one, and one more while the loss of the first is not yet noticed
EARLY = 1_000_000  # bytes


class _Visitor(asyncio.Protocol):
    """One connection from the environment."""

    def __init__(self, relay: Relay) -> None:
        self.transport: asyncio.Transport
        self.gone = False
        self._early = b""  # what came before the Master was reached
        self._relay = relay
        self._onward: _Onward | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)
        if not self._relay.admit(self):
            self.transport.abort()
            return
        factory = Factory.forProtocol(lambda: _Onward(self))
        self._relay.master.connect(factory).addCallbacks(self._reached, self._unreachable)

    def data_received(self, data: bytes) -> None:
        if self._onward is not None:
            self._onward.transport.write(data)
        elif len(self._early) + len(data) <= EARLY:
            self._early += data
        else:
            self.transport.abort()

    def pause_writing(self) -> None:
        if self._onward is not None:
            self._onward.transport.pauseProducing()

    def resume_writing(self) -> None:
        if self._onward is not None:
            self._onward.transport.resumeProducing()

    def connection_lost(self, exc: Exception | None) -> None:
        self.gone = True
        self._relay.dismiss(self)
        if self._onward is not None and not self._onward.lost:  # Twisted's TLS cannot be aborted twice
            self._onward.transport.abortConnection()

    # as the producer of what goes to the Master

    def pauseProducing(self) -> None:
        self.transport.pause_reading()

    def resumeProducing(self) -> None:
        self.transport.resume_reading()

    def stopProducing(self) -> None:
        self.transport.abort()

    def _reached(self, onward: _Onward) -> None:
        if self.gone:
            onward.transport.abortConnection()
            return
        self._onward = onward
        onward.transport.registerProducer(self, True)
        onward.transport.write(self._early)

    def _unreachable(self, reason: Failure) -> None:
        log.info("the Master cannot be reached: {reason}", reason=reason.getErrorMessage())
        self.transport.abort()


class _Onward(Protocol):
    """The connection to the Master that belongs to a visitor."""

    transport: Connection  # type: ignore[assignment]  # or one that wraps it, for TLS

    def __init__(self, visitor: _Visitor) -> None:
        self.lost = False
        self._visitor = visitor

    def dataReceived(self, data: bytes) -> None:
        self._visitor.transport.write(data)

    def connectionLost(self, reason: Failure = connectionDone) -> None:
        self.lost = True
        self._visitor.transport.close()


class Relay:
    """Takes connections at `control.sock` in a directory; passes them on, byte for byte, to a Twisted client endpoint.

    Who may do what is the Master's to judge; here it is only bounded how many an environment has at once.
    """

    def __init__(self, reactor: ReactorBase, master: str, tls: Tls | None = None) -> None:
        self.master = client_endpoint(reactor, master, tls)
        self._visitors: set[_Visitor] = set()
        self._server: asyncio.Server | None = None

    async def open(self, directory: Path) -> None:
        """Raises OSError."""
        listener = bound(directory / SOCKET, 0o666)  # everybody who sees the directory may use it
        self._server = await asyncio.get_running_loop().create_unix_server(lambda: _Visitor(self), sock=listener)

    def close(self) -> None:
        if self._server is not None:
            self._server.close()
        for visitor in self._visitors:
            visitor.transport.abort()

    def admit(self, visitor: _Visitor) -> bool:
        if len(self._visitors) >= VISITORS:
            return False
        self._visitors.add(visitor)
        return True

    def dismiss(self, visitor: _Visitor) -> None:
        self._visitors.discard(visitor)
