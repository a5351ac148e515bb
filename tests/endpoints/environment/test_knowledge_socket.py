"""The socket at which programs of an environment use the knowledge service, with its client."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from endpoints.environment import knowledge_socket
from endpoints.environment.knowledge_socket import KnowledgeSocket
from rce.api.knowledge_requests import FindEntries, Found, KnowledgeAnswer, KnowledgeRequest
from rce.client.environment_knowledge import EnvironmentKnowledge
from rce.errors import LimitExceeded, NotFound
from rce.net.sockets import unix_socket_path


@asynccontextmanager
async def served(path: Path, ask: Any) -> AsyncIterator[EnvironmentKnowledge]:
    server = KnowledgeSocket(ask)
    await server.listen(path)
    try:
        yield EnvironmentKnowledge(path)
    finally:
        await server.close()


def exchange(path: Path, data: bytes) -> bytes:
    """Send bytes and return all that comes until the connection is closed."""
    with socket.socket(socket.AF_UNIX) as connection, unix_socket_path(path) as short:
        connection.settimeout(30)
        connection.connect(short)
        connection.sendall(data)
        connection.shutdown(socket.SHUT_WR)
        received = b""
        while piece := connection.recv(65536):
            received += piece
        return received


async def test_answers_and_errors_reach_the_program(tmp_path: Path) -> None:
    asked: list[KnowledgeRequest] = []

    async def ask(request: KnowledgeRequest) -> KnowledgeAnswer:
        asked.append(request)
        if len(asked) > 1:
            raise NotFound("gone", field="uid")
        return KnowledgeAnswer([Found("cup.blue", 3, ["a"])])

    async with served(tmp_path / "k.sock", ask) as client:
        assert await asyncio.to_thread(client.search, "object", "cup") == [Found("cup.blue", 3, ["a"])]
        with pytest.raises(NotFound, match="gone") as caught:
            await asyncio.to_thread(client.find, "object", "cup")
    assert caught.value.field == "uid"
    assert asked == [FindEntries("object", "cup"), FindEntries("object", "cup", exact=True)]


async def test_rubbish_is_an_error_and_a_frame_that_is_too_long_ends_the_connection(tmp_path: Path) -> None:
    async def ask(_: KnowledgeRequest) -> KnowledgeAnswer:
        raise AssertionError

    path = tmp_path / "k.sock"
    async with served(path, ask):
        reply = await asyncio.to_thread(exchange, path, (3).to_bytes(4, "big") + b"abc")
        assert b"no request to the knowledge service" in reply
        assert await asyncio.to_thread(exchange, path, b"\xff\xff\xff\xff" + b"x" * 100) == b""
        assert await asyncio.to_thread(exchange, path, b"\0\0") == b""


async def test_programs_beyond_the_limit_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(knowledge_socket, "MOST", 1)
    waiting, go_on = asyncio.Event(), asyncio.Event()

    async def ask(_: KnowledgeRequest) -> KnowledgeAnswer:
        waiting.set()
        await go_on.wait()
        return KnowledgeAnswer()

    async with served(tmp_path / "k.sock", ask) as client:
        first = asyncio.ensure_future(asyncio.to_thread(client.search, "object", "cup"))
        await waiting.wait()
        with pytest.raises(LimitExceeded):
            await asyncio.to_thread(client.search, "object", "cup")
        go_on.set()
        assert await first == []
