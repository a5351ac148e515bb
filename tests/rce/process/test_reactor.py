"""Twisted's sockets under uvloop."""

from __future__ import annotations

import asyncio
import socket
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Any

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


@asynccontextmanager
async def listening(reactor: ReactorBase, accepted: asyncio.Queue[Server]) -> AsyncIterator[tuple[str, int]]:
    assert isinstance(reactor, UvloopReactor)
    factory = Factory.forProtocol(lambda: Server(accepted))
    port: IListeningPort = reactor.listenTCP(0, factory, interface="127.0.0.1")  # type: ignore[no-untyped-call]
    yield "127.0.0.1", port.getHost().port  # type: ignore[misc]  # zope declares it without self
    await port.stopListening().asFuture(asyncio.get_running_loop())  # type: ignore[misc,union-attr]


async def test_connection_reset_is_reported_despite_pending_data(reactor: ReactorBase) -> None:
    accepted: asyncio.Queue[Server] = asyncio.Queue()
    async with listening(reactor, accepted) as address:
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


async def test_more_than_the_kernel_takes_arrives_before_the_end(reactor: ReactorBase) -> None:
    accepted: asyncio.Queue[Server] = asyncio.Queue()
    async with listening(reactor, accepted) as address:
        reader, writer = await asyncio.open_connection(*address)
        server = await asyncio.wait_for(accepted.get(), TIMEOUT)
        transport: Any = server.transport
        sent = bytes(range(256)) * 100_000
        for start in range(0, len(sent), 1_000_000):
            transport.write(sent[start : start + 1_000_000])
        transport.loseConnection()
        assert await asyncio.wait_for(reader.read(-1), TIMEOUT) == sent
        writer.close()
        await asyncio.wait_for(server.lost, TIMEOUT)
        assert isinstance(reactor, UvloopReactor)
        assert not reactor.getWriters()


async def test_data_of_an_aborted_connection_is_dropped(reactor: ReactorBase) -> None:
    accepted: asyncio.Queue[Server] = asyncio.Queue()
    async with listening(reactor, accepted) as address:
        reader, writer = await asyncio.open_connection(*address)
        server = await asyncio.wait_for(accepted.get(), TIMEOUT)
        transport: Any = server.transport
        transport.write(b"never sent")
        transport.abortConnection()
        with suppress(ConnectionResetError):
            assert await asyncio.wait_for(reader.read(-1), TIMEOUT) == b""
        writer.close()
        await asyncio.wait_for(server.lost, TIMEOUT)
        assert isinstance(reactor, UvloopReactor)
        assert not reactor.getWriters()
