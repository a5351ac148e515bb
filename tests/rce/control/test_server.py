"""Joining at the listening side of control connections."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest
from twisted.internet.base import ReactorBase
from twisted.spread import pb

from rce.control import broker
from rce.control.calls.call import Nothing
from rce.control.calls.endpoints import StopNode
from rce.control.calls.joining import Hello, Welcome
from rce.control.client import client_endpoint, connect
from rce.control.connection import CallReceiver, Control, Handlers
from rce.control.pages import Pages, decode_pages, encode_pages
from rce.control.server import listen
from rce.errors import ErrorInfo, InvalidRequest, Unauthorized
from tests.support.control import HELLO, TIMEOUT, Listener, OpenJoiner, listening


class GuardedJoiner(OpenJoiner):
    """Admits processes with the token `token`; keeps their addresses."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []

    async def join(self, hello: Hello, address: str) -> tuple[Welcome, Handlers, Callable[[Control], None]]:
        self.addresses.append(address)
        if hello.token != "token":
            raise Unauthorized(f"{hello.name} has no valid token")
        return await super().join(hello, address)


@pytest.fixture
async def guarded(reactor: ReactorBase) -> AsyncIterator[Listener]:
    async with listening(reactor, joiner=GuardedJoiner()) as listener:
        yield listener


async def join_raw(reactor: ReactorBase, description: str, pages: Pages) -> tuple[bool, Pages]:
    """Call `join` with any pages; return the answer."""
    loop = asyncio.get_running_loop()
    factory = pb.PBClientFactory()
    await client_endpoint(reactor, description, None).connect(factory).asFuture(loop)
    root = await factory.getRootObject().asFuture(loop)
    good, answer, _ = await root.callRemote("join", pages, CallReceiver(Handlers())).asFuture(loop)
    lost = loop.create_future()
    root.broker.notifyOnDisconnect(lambda: lost.set_result(None))
    factory.disconnect()
    await asyncio.wait_for(lost, TIMEOUT)
    return good, answer


async def test_peer_that_asked_to_join_waits_for_its_answer_beyond_the_timeout(
    reactor: ReactorBase, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a restart of the Master thousands ask at once; who is refused for the Master's own delay asks again."""
    monkeypatch.setattr(broker, "JOIN_TIMEOUT", 0.02)

    class BusyJoiner(OpenJoiner):
        async def join(self, hello: Hello, address: str) -> tuple[Welcome, Handlers, Callable[[Control], None]]:
            await asyncio.sleep(5 * broker.JOIN_TIMEOUT)
            return await super().join(hello, address)

    async with listening(reactor, joiner=BusyJoiner()) as listener:
        control, _ = await listener.pair(Handlers())
        assert not control.lost.done()


async def test_many_processes_may_connect_at_once(reactor: ReactorBase) -> None:
    """The loop does not run meanwhile, so that none of these connections is accepted by the program."""
    async with listening(reactor) as listener:
        connections = [socket.create_connection(("127.0.0.1", listener.port), TIMEOUT) for _ in range(300)]
        for connection in connections:
            connection.close()


async def test_refused_process_gets_the_reason(reactor: ReactorBase, guarded: Listener) -> None:
    with pytest.raises(Unauthorized, match="m1 has no valid token"):
        await connect(reactor, guarded.description, Hello("container", "m1", "wrong", "1"), Handlers())
    assert guarded.joiner.joined.empty()


async def test_joiner_gets_the_address_of_the_peer(reactor: ReactorBase, guarded: Listener) -> None:
    client, server = await guarded.pair(Handlers())
    assert isinstance(guarded.joiner, GuardedJoiner)
    assert [server.address] == guarded.joiner.addresses
    assert server.address.startswith("127.0.0.1:")
    client.close()
    await asyncio.wait_for(server.lost, TIMEOUT)


@pytest.mark.parametrize("pages", [[b"\xff"], [], encode_pages(Nothing())], ids=["garbage", "nothing", "other type"])
async def test_malformed_hello_is_refused(reactor: ReactorBase, guarded: Listener, pages: Pages) -> None:
    good, answer = await join_raw(reactor, guarded.description, pages)
    assert not good
    assert decode_pages(answer, ErrorInfo).code == InvalidRequest.code
    assert isinstance(guarded.joiner, GuardedJoiner)
    assert guarded.joiner.addresses == []


async def test_first_call_of_the_server_finds_the_handlers_of_the_process(reactor: ReactorBase) -> None:
    stopped: list[str] = []
    handlers = Handlers()
    handlers.do(StopNode, lambda call: stopped.append(call.node))
    async with listening(reactor) as listener:
        client, server = await listener.pair(handlers)
        await server.call(StopNode("echo"))
        assert stopped == ["echo"]
        client.close()
        await asyncio.wait_for(server.lost, TIMEOUT)


async def test_unix_socket(reactor: ReactorBase, tmp_path: Path) -> None:
    joiner = OpenJoiner()
    port = await listen(reactor, f"unix:{tmp_path}/control.sock", joiner)
    client, _ = await connect(reactor, f"unix:{tmp_path}/control.sock", HELLO, Handlers())
    server = await asyncio.wait_for(joiner.joined.get(), TIMEOUT)
    assert server.address == "local:0"
    client.close()
    await asyncio.wait_for(server.lost, TIMEOUT)
    await port.stopListening().asFuture(asyncio.get_running_loop())  # type: ignore[misc,union-attr]


@pytest.mark.parametrize("description", ["", "tcp", "tcp:", "tcp:x", "nonsense:1"])
async def test_malformed_description_is_refused(reactor: ReactorBase, description: str) -> None:
    with pytest.raises(InvalidRequest, match="is not a Twisted server endpoint"):
        await listen(reactor, description, OpenJoiner())


async def test_process_joins_once_in_a_connection(reactor: ReactorBase) -> None:
    async with listening(reactor) as listener:
        client, server = await listener.pair(Handlers())
        root = client._receiver.broker.remoteForName("root")
        joined = root.callRemote("join", encode_pages(HELLO), CallReceiver(Handlers()))
        good, answer, _ = await joined.asFuture(asyncio.get_running_loop())
        assert not good
        assert "once in a connection" in decode_pages(answer, ErrorInfo).message
        assert listener.joiner.joined.empty()
        client.close()
        await asyncio.wait_for(server.lost, TIMEOUT)


async def test_join_without_a_receiver_of_calls_is_refused(reactor: ReactorBase) -> None:
    async with listening(reactor) as listener:
        factory = pb.PBClientFactory()
        loop = asyncio.get_running_loop()
        await client_endpoint(reactor, listener.description, None).connect(factory).asFuture(loop)
        root = await factory.getRootObject().asFuture(loop)
        good, _, _ = await root.callRemote("join", encode_pages(HELLO), 7).asFuture(loop)
        assert not good
        lost = loop.create_future()
        root.broker.notifyOnDisconnect(lambda: lost.set_result(None))
        factory.disconnect()
        await asyncio.wait_for(lost, TIMEOUT)
        assert listener.joiner.joined.empty()
