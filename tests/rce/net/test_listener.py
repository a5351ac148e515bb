"""Listening sockets that bound pending logins and TLS handshakes."""

from __future__ import annotations

import asyncio
import errno
import socket
import ssl
from collections.abc import AsyncIterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from rce.errors import Unavailable
from rce.net import listener as module
from rce.net import pending_logins
from rce.net.certificates import Authority
from rce.net.listener import Listener, bind
from rce.net.pending_logins import PendingLogin
from rce.net.tls import CA, CERTIFICATE, KEY, public_tls_context
from tests.support.certificates import certify
from tests.support.endpoints.raw_robot import eventually


class Greeting(asyncio.Protocol):
    """Greets each client, which has thereby logged in if it answers."""

    def __init__(self, pending: PendingLogin) -> None:
        self._pending = pending

    def connection_made(self, transport: Any) -> None:
        transport.write(b"hello")

    def data_received(self, data: bytes) -> None:
        self._pending.end()

    def connection_lost(self, exc: Exception | None) -> None:
        self._pending.end()


@pytest.fixture
async def listener(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Listener]:
    """Listener that takes two pending logins, also from this machine."""
    monkeypatch.setattr(pending_logins, "MAX_PENDING", 2)
    monkeypatch.setattr(pending_logins, "network", lambda address: address)
    listener = Listener(bind("127.0.0.1", 0), Greeting, None)
    yield listener
    listener.close()


class Client:
    """Connection to a listener, which is closed at the end of the test."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def received(self) -> bytes:
        """Return what comes first; nothing if the connection is closed."""
        try:
            return await asyncio.wait_for(self.reader.read(5), 20)
        except ConnectionResetError:
            return b""


async def connect(port: int) -> Client:
    return Client(*await asyncio.open_connection("127.0.0.1", port))


async def test_connections_that_come_at_once_are_accepted_in_small_batches(
    listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pending_logins, "MAX_PENDING", 100)
    connections = [socket.create_connection(("127.0.0.1", listener.port)) for _ in range(9)]
    accepted = [0]
    while accepted[-1] < len(connections):
        await asyncio.sleep(0)
        accepted.append(len(listener.pending))
    assert max(after - before for before, after in pairwise(accepted)) <= 2
    for connection in connections:
        connection.close()


async def test_connections_without_login_are_bounded(listener: Listener) -> None:
    clients = [await connect(listener.port) for _ in range(2)]
    assert [await client.received() for client in clients] == [b"hello"] * 2
    clients.append(await connect(listener.port))
    assert await clients[-1].received() == b""
    clients[0].writer.write(b"login")
    await eventually(lambda: len(listener.pending) == 1)
    clients.append(await connect(listener.port))
    assert await clients[-1].received() == b"hello"
    for client in clients:
        client.writer.close()
    await eventually(lambda: len(listener.pending) == 0)


async def test_client_that_does_not_begin_tls_is_disconnected(
    listener: Listener, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "TLS_TIMEOUT", 0.1)
    keys = certify(tmp_path / "tls", Authority.make("tests"), ["localhost"])
    secure = Listener(bind("127.0.0.1", 0), Greeting, public_tls_context(str(keys / CERTIFICATE), str(keys / KEY)))
    client = await connect(secure.port)
    await eventually(lambda: len(secure.pending) == 1)
    assert await client.received() == b""
    await eventually(lambda: len(secure.pending) == 0)
    trust = ssl.create_default_context(cafile=str(keys / CA))
    monkeypatch.setattr(module, "TLS_TIMEOUT", 20.0)
    reader, writer = await asyncio.open_connection("localhost", secure.port, ssl=trust)
    assert await reader.read(5) == b"hello"
    writer.close()
    client.writer.close()
    secure.close()


async def test_accepting_continues_after_file_descriptors_ran_out(
    listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "PAUSE", 0.01)

    accept, failures = socket.socket.accept, [OSError(errno.EMFILE, "too many open files")]

    def fail_once(listening: socket.socket) -> tuple[socket.socket, Any]:
        if failures:
            raise failures.pop()
        return accept(listening)

    monkeypatch.setattr(socket.socket, "accept", fail_once)
    client = await connect(listener.port)
    assert await client.received() == b"hello"
    assert not failures
    client.writer.close()


async def test_closed_listener_frees_its_port_and_keeps_connections(listener: Listener) -> None:
    other = Listener(bind("127.0.0.1", 0), Greeting, None)
    client = await connect(other.port)
    assert await client.received() == b"hello"
    port = other.port
    with pytest.raises(Unavailable, match=f"port {port} of 127.0.0.1 is in use"):
        bind("127.0.0.1", port)
    other.close()
    bind("127.0.0.1", port).close()
    client.writer.write(b"still here")
    await client.writer.drain()
    client.writer.close()
