"""Sockets that report an error while they still have data to read, under uvloop."""

from __future__ import annotations

import asyncio
import socket
import struct

from twisted.internet.base import ReactorBase
from twisted.internet.interfaces import IListeningPort
from twisted.internet.protocol import Factory, Protocol
from twisted.python.failure import Failure

from rce.process.reactor import UvloopReactor

TIMEOUT = 20.0  # seconds


class Server(Protocol):
    """One accepted connection."""

    def __init__(self, accepted: asyncio.Queue[Server]) -> None:
        self.accepted = accepted
        self.received = b""
        self.lost: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def connectionMade(self) -> None:
        self.accepted.put_nowait(self)

    def dataReceived(self, data: bytes) -> None:
        self.received += data

    def connectionLost(self, reason: Failure) -> None:  # type: ignore[override]  # Twisted always passes it
        self.lost.set_result(None)


def reset(client: socket.socket, data: bytes) -> None:
    """Send data and abort the connection, as the kernel does when a process is killed."""
    client.send(data)
    client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    client.close()


async def test_connection_reset_is_reported_despite_pending_data(reactor: ReactorBase) -> None:
    assert isinstance(reactor, UvloopReactor)
    accepted: asyncio.Queue[Server] = asyncio.Queue()
    factory = Factory.forProtocol(lambda: Server(accepted))
    port: IListeningPort = reactor.listenTCP(0, factory, interface="127.0.0.1")  # type: ignore[no-untyped-call]
    address = "127.0.0.1", port.getHost().port  # type: ignore[misc]  # zope declares it without self
    for number in range(3):  # later connections may have the file descriptor of an earlier one
        client = socket.create_connection(address)
        server = await asyncio.wait_for(accepted.get(), TIMEOUT)
        reset(client, b"last %d" % number)
        await asyncio.wait_for(server.lost, TIMEOUT)
    client = socket.create_connection(address)
    server = await asyncio.wait_for(accepted.get(), TIMEOUT)
    client.send(b"hello")
    client.close()
    await asyncio.wait_for(server.lost, TIMEOUT)
    assert server.received == b"hello"
    await port.stopListening().asFuture(asyncio.get_running_loop())  # type: ignore[misc,union-attr]
