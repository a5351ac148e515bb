"""The relay: bytes both ways, however early they come, and bounds on who comes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path

import pytest
from certified import certify
from twisted.internet.base import ReactorBase

from containers import relay
from containers.relay import SOCKET, VISITORS, Relay
from rce.certificates import Authority
from rce.tls import Tls


class Master:
    """Answers every line with the same in capitals."""

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
    """Whether the other side closes the connection, in whatever way, before it says anything."""
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
    opened = Relay(reactor, await master.start(tls), tls)
    await opened.open(tmp_path)
    monkeypatch.chdir(tmp_path)  # the whole path may be too long for a socket's
    yield SOCKET
    opened.close()


async def test_both_ways(path: str) -> None:
    reader, writer = await asyncio.open_unix_connection(path, limit=10_000_000)
    for words in (b"early\n", b"x" * 3_000_000 + b"\n"):
        writer.write(words)
        assert await reader.readline() == words.upper()
    writer.close()


async def test_who_ends_it_ends_it_for_the_other(path: str, master: Master) -> None:
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


async def test_too_many_are_sent_away(path: str, master: Master) -> None:
    lines = []
    for _ in range(VISITORS):
        reader, writer = await asyncio.open_unix_connection(path)
        writer.write(b"a\n")
        assert await reader.readline() == b"A\n"
        lines.append(writer)
    reader, writer = await asyncio.open_unix_connection(path)
    assert await closed(reader)
    writer.close()
    assert master.served == VISITORS
    for each in lines:
        each.close()


async def test_no_master_closes_the_connection(
    reactor: ReactorBase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = Relay(reactor, "tcp:127.0.0.1:1")
    await opened.open(tmp_path)
    monkeypatch.chdir(tmp_path)
    reader, writer = await asyncio.open_unix_connection(SOCKET)
    assert await closed(reader)
    writer.close()
    opened.close()


async def test_what_comes_early_is_bounded(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relay, "EARLY", -1)
    reader, writer = await asyncio.open_unix_connection(path)
    writer.write(b"too early\n")
    assert await closed(reader)
    writer.close()
