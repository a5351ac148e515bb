"""Joining the Master, and Masters that are silent or end during the handshake."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress

import pytest
from twisted.internet.base import ReactorBase

from rce.control import client
from rce.control.calls.joining import Hello, Welcome
from rce.control.client import ControlClient, addresses, connect
from rce.control.connection import Control, Handlers
from rce.errors import InvalidRequest, Unavailable
from tests.support.control import HELLO, TIMEOUT, OpenJoiner, listening


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


def test_masters_are_separated_by_commas() -> None:
    assert addresses("tcp:a:8080, tcp:b:8080,") == ["tcp:a:8080", "tcp:b:8080"]
    with pytest.raises(InvalidRequest, match="setting master"):
        addresses(" ,")


class Standby(OpenJoiner):
    """Refuses every process, or does not answer."""

    def __init__(self, answers: bool) -> None:
        super().__init__()
        self.asked = asyncio.Event()
        self.answers = answers

    async def join(self, hello: Hello, address: str) -> tuple[Welcome, Handlers, Callable[[Control], None]]:
        self.asked.set()
        if not self.answers:
            await asyncio.Event().wait()
        raise Unavailable("this Master is a standby")


@pytest.mark.parametrize("answers", [True, False])
async def test_process_joins_the_master_that_leads(reactor: ReactorBase, answers: bool) -> None:
    """The other one is a standby, or was stopped: the kernel still accepts connections for it."""
    standby = Standby(answers)
    async with listening(reactor, joiner=standby) as other, listening(reactor) as leader:
        masters = f"{other.description},tcp:127.0.0.1:1,{leader.description}"
        link = ControlClient(reactor, masters, lambda: HELLO, Handlers(), lambda welcome: None)
        task = asyncio.create_task(link.run())
        await asyncio.wait_for(standby.asked.wait(), TIMEOUT)
        server = await asyncio.wait_for(leader.joiner.joined.get(), TIMEOUT)
        while not link.connected:  # noqa: ASYNC110  # the answer is on its way
            await asyncio.sleep(0.001)
        assert link.master == leader.description
        server.close()
        again = await asyncio.wait_for(leader.joiner.joined.get(), TIMEOUT)
        task.cancel()
        await asyncio.wait_for(again.lost, TIMEOUT)
        await asyncio.wait({task})
