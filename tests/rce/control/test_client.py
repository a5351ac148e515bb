"""Joining the Master, and Masters that are silent or end during the handshake."""

from __future__ import annotations

import asyncio
from contextlib import suppress

import pytest
from twisted.internet.base import ReactorBase

from rce.control import client
from rce.control.calls.joining import Welcome
from rce.control.client import ControlClient, connect
from rce.control.connection import Handlers
from rce.errors import Unavailable
from tests.support.control import HELLO, TIMEOUT, listening


async def test_join_returns_the_credential(reactor: ReactorBase) -> None:
    async with listening(reactor) as listener:
        control, welcome = await connect(reactor, listener.description, HELLO, Handlers())
        assert welcome == Welcome("credential")
        control.close()
        await asyncio.wait_for((await listener.joiner.joined.get()).lost, TIMEOUT)


async def test_join_times_out_if_the_master_is_silent(reactor: ReactorBase, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client, "JOIN_TIMEOUT", 0.02)
    closed = asyncio.Event()

    async def silent(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(ConnectionResetError):
            await reader.read()
        writer.close()
        closed.set()

    async with await asyncio.start_server(silent, "127.0.0.1", 0) as server:
        address = server.sockets[0].getsockname()
        with pytest.raises(Unavailable, match=r"no answer within 0\.02 s"):
            await connect(reactor, f"tcp:127.0.0.1:{address[1]}", HELLO, Handlers())
        await asyncio.wait_for(closed.wait(), TIMEOUT)


async def test_join_fails_at_once_if_the_master_closes_the_connection(
    reactor: ReactorBase, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel of a Master that ends may still accept the connection."""
    monkeypatch.setattr(client, "JOIN_TIMEOUT", 10 * TIMEOUT)

    async def end(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.transport.abort()

    async with await asyncio.start_server(end, "127.0.0.1", 0) as server:
        description = f"tcp:127.0.0.1:{server.sockets[0].getsockname()[1]}"
        with pytest.raises(Unavailable, match="lost"):
            await asyncio.wait_for(connect(reactor, description, HELLO, Handlers()), TIMEOUT)


async def test_cancelled_client_closes_its_connection(reactor: ReactorBase) -> None:
    async with listening(reactor) as listener:
        link = ControlClient(reactor, listener.description, lambda: HELLO, Handlers(), lambda welcome: None)
        task = asyncio.create_task(link.run())
        server = await asyncio.wait_for(listener.joiner.joined.get(), TIMEOUT)
        task.cancel()
        await asyncio.wait_for(server.lost, TIMEOUT)
        await asyncio.wait({task})
