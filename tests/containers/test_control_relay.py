"""Relay of environments to the Master: forwarding in both directions, and limits."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path

import pytest
from twisted.internet.base import ReactorBase

from containers import control_relay
from containers.control_relay import MAX_CONNECTIONS, SOCKET, ControlRelay
from rce.net.certificates import Authority
from rce.net.tls import Tls
from tests.support.certificates import certify


class Master:
    """Server that answers every line in capitals."""

    def __init__(self) -> None:
        self.served = 0
        self.server: asyncio.Server

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.served += 1
        with suppress(ConnectionError):
            while (line := await reader.readline()) not in (b"", b"enough\n"):
                writer.write(line.upper())
        writer.close()

    async def start(self, tls: Tls | None) -> str:
        context = tls.server if tls else None
        self.server = await asyncio.start_server(self.serve, "127.0.0.1", 0, limit=10_000_000, ssl=context)
        return f"tcp:127.0.0.1:{self.server.sockets[0].getsockname()[1]}"


async def closed(reader: asyncio.StreamReader) -> bool:
    """Return True if the peer closes the connection, in any way, without sending anything."""
    try:
        return await reader.read() == b""
    except ConnectionError:
        return True


@pytest.fixture
async def master() -> AsyncIterator[Master]:
    master = Master()
    yield master
    master.server.close()


@pytest.fixture(params=["plain", "tls"])
async def path(
    request: pytest.FixtureRequest,
    master: Master,
    reactor: ReactorBase,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> AsyncIterator[str]:
    tls = Tls(certify(tmp_path / "tls", Authority.make("test"), ["127.0.0.1"])) if request.param == "tls" else None
    opened = ControlRelay(reactor, await master.start(tls), tls)
    await opened.open(tmp_path)
    monkeypatch.chdir(tmp_path)  # the whole path may be too long for a socket address
    yield SOCKET
    opened.close()


async def test_data_is_relayed_both_ways(path: str) -> None:
    reader, writer = await asyncio.open_unix_connection(path, limit=10_000_000)
    for words in (b"early\n", b"x" * 3_000_000 + b"\n"):
        writer.write(words)
        assert await reader.readline() == words.upper()
    writer.close()


async def test_end_of_one_connection_ends_the_other(path: str, master: Master) -> None:
    reader, writer = await asyncio.open_unix_connection(path)
    writer.write(b"enough\n")
    assert await closed(reader)
    writer.close()
    _, writer = await asyncio.open_unix_connection(path)
    writer.close()
    await writer.wait_closed()
    reader, writer = await asyncio.open_unix_connection(path)
    writer.write(b"a\n")
    assert await reader.readline() == b"A\n"
    writer.close()


async def test_excess_connections_are_closed(path: str, master: Master) -> None:
    lines = []
    for _ in range(MAX_CONNECTIONS):
        reader, writer = await asyncio.open_unix_connection(path)
        writer.write(b"a\n")
        assert await reader.readline() == b"A\n"
        lines.append(writer)
    reader, writer = await asyncio.open_unix_connection(path)
    assert await closed(reader)
    writer.close()
    assert master.served == MAX_CONNECTIONS
    for each in lines:
        each.close()


async def test_connection_is_closed_if_the_master_is_unreachable(
    reactor: ReactorBase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = ControlRelay(reactor, "tcp:127.0.0.1:1")
    await opened.open(tmp_path)
    monkeypatch.chdir(tmp_path)
    reader, writer = await asyncio.open_unix_connection(SOCKET)
    assert await closed(reader)
    writer.close()
    opened.close()


async def test_early_data_is_bounded(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control_relay, "MAX_EARLY", -1)
    reader, writer = await asyncio.open_unix_connection(path)
    writer.write(b"too early\n")
    assert await closed(reader)
    writer.close()


async def test_connections_go_to_the_master_that_leads(reactor: ReactorBase, master: Master, tmp_path: Path) -> None:
    other = Master()
    first, second = await master.start(None), await other.start(None)
    opened = ControlRelay(reactor, f"{first},{second}")
    await opened.open(tmp_path)
    reader, writer = await asyncio.open_unix_connection(tmp_path / SOCKET)
    writer.write(b"a\n")
    assert await reader.readline() == b"A\n"
    opened.lead(first)
    writer.write(b"b\n")
    assert await reader.readline() == b"B\n"
    opened.lead(second)
    assert await closed(reader)
    writer.close()
    reader, writer = await asyncio.open_unix_connection(tmp_path / SOCKET)
    writer.write(b"c\n")
    assert await reader.readline() == b"C\n"
    assert (master.served, other.served) == (1, 1)
    writer.close()
    opened.close()
    other.server.close()
