"""Limits of the control port for peers that have not joined, and for the size of a message."""

from __future__ import annotations

import asyncio
import gc
import sys
from collections.abc import AsyncIterator
from typing import Any

import pytest
from twisted.internet.base import ReactorBase
from twisted.spread.banana import encode

from rce.control import broker, limits
from rce.control.calls.call import Nothing
from rce.control.calls.endpoints import StopNode
from rce.control.calls.joining import Hello
from rce.control.calls.watching import Log, ReadLog
from rce.control.connection import Handlers
from rce.errors import InvalidRequest, LimitExceeded, Lost
from tests.support.control import TIMEOUT, Listener, closed, listening

ENVIRONMENT = Hello("environment", "ann/brain", "token", "1")

PB = b"\x02\x82pb"  # the protocol dialect that a client chooses first


@pytest.fixture
async def listener(reactor: ReactorBase) -> AsyncIterator[Listener]:
    handlers = Handlers()
    handlers.do(StopNode, lambda call: None)
    async with listening(reactor, handlers) as listener:
        yield listener


async def send_until_closed(port: int, data: bytes) -> None:
    """Send data; return when the other side has closed the connection."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(data)
    try:
        async with asyncio.timeout(TIMEOUT):
            while await reader.read(1000):
                pass
    except ConnectionError:
        pass
    writer.transport.abort()


@pytest.mark.parametrize(
    "data",
    [
        PB + b"\x01\x80" * 100,  # nested lists
        PB + b"\x00\x00\x28\x80" + b"\x01\x81" * 10_000,  # a long list of numbers
        PB + b"\x00\x00\x28\x80" + (b"\x00\x00\x28\x82" + bytes(655_360)) * 8,  # a list of large strings
        b"GET / HTTP/1.1\r\nHost: " + b"x" * 100 + b"\r\n\r\n",
        PB + bytes(1000),
        PB + b"\x01\x82\xff",  # not a call
    ],
    ids=["deep", "long", "large", "http", "zeros", "no call"],
)
async def test_unjoined_peer_that_exceeds_the_limits_is_disconnected(listener: Listener, data: bytes) -> None:
    await send_until_closed(listener.port, data)
    client, server = await listener.pair(Handlers())
    await closed(client, server)


@pytest.mark.parametrize(
    "reference", [[b"remote"], [b"remote", b"x"], [b"remote", 1, 2], [b"twisted.spread.pb.Root", 1]]
)
async def test_malformed_reference_makes_no_object(
    listener: Listener, reference: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half of one would be made, and its end logged with a traceback."""
    ignored: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", ignored.append)
    join = [b"message", 1, b"root", b"join", 1, [b"tuple", [b"list", b"hello"], reference], [b"dictionary"]]
    await send_until_closed(listener.port, PB + encode(join) + encode([b"no call"]))
    gc.collect()
    assert not ignored


async def test_unjoined_connection_is_closed_after_the_timeout(
    listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(broker, "JOIN_TIMEOUT", 0.02)
    await send_until_closed(listener.port, b"")


async def test_message_size_is_limited_after_joining(listener: Listener, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MAX_MESSAGE", 1_000_000)
    client, server = await listener.pair(Handlers())
    for _ in range(5):
        with pytest.raises(InvalidRequest, match="does not answer"):
            await client.call(ReadLog("n" * 300_000))
    client._max_size = 2_000_000  # a sound process refuses to send more
    with pytest.raises(Lost):
        await client.call(ReadLog("n" * 1_100_000))
    await asyncio.wait_for(server.lost, TIMEOUT)


async def test_size_limit_applies_to_each_message_of_a_burst(
    listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "MAX_MESSAGE", 1_000_000)
    client, server = await listener.pair(Handlers())
    calls = (client.call(ReadLog("n" * 300_000)) for _ in range(20))
    assert {type(each) for each in await asyncio.gather(*calls, return_exceptions=True)} == {InvalidRequest}
    await closed(client, server)


async def test_message_of_an_environment_has_one_mebibyte_at_most(listener: Listener) -> None:
    async def read(call: ReadLog) -> Log:
        return Log(["x" * call.lines])

    handlers = Handlers()
    handlers.on(ReadLog, read)
    client, server = await listener.pair(handlers, hello=ENVIRONMENT)
    for size, fits in ((1_040_000, True), (1_050_000, False)):
        with pytest.raises(InvalidRequest if fits else LimitExceeded):
            await client.call(ReadLog("n" * size))
    assert await server.call(ReadLog("n", 1_000_000))
    with pytest.raises(LimitExceeded, match="more than the 1047576 that a process of this role may send"):
        await server.call(ReadLog("n", 1_050_000))
    client._max_size = 2_000_000
    with pytest.raises(Lost):
        await client.call(ReadLog("n" * 1_050_000))
    await asyncio.wait_for(server.lost, TIMEOUT)


@pytest.mark.parametrize(
    "message",
    [
        [b"message", 9, b"root", b"join", 1, [b"tuple"], [b"dictionary"]],
        [b"message", 9, b"root", b"nothing", 1, [b"tuple"], [b"dictionary"]],
        [b"message", 9, b"nobody", b"join", 1, [b"tuple"], [b"dictionary"]],
        [b"message", 9, [b"root"], b"join", 1, [b"tuple"], [b"dictionary"]],
        [b"message", 9, b"root", b"join", 1, [b"module", b"os"], [b"dictionary"]],
        [b"message", 9, b"root", b"join", 1, [b"tuple", [b"unicode", b"\xff"]], [b"dictionary"]],
        [b"message", 9, b"root", b"\xff", 1, [b"tuple"], [b"dictionary"]],
        [b"cachemessage", 9, 1, b"join", 1, [b"tuple"], [b"dictionary"]],
        [b"didNotUnderstand", b"x"],
        [b"answer", 9, [b"tuple"]],
        [b"error", 9, [b"tuple"]],
        [b"decref", 9],
        [b"message"],
        [],
        7,
    ],
    ids=str,
)
@pytest.mark.parametrize("joined", [False, True], ids=["unjoined", "joined"])
async def test_malformed_call_is_not_logged_with_a_traceback(
    listener: Listener, failures: list[object], message: Any, joined: bool
) -> None:
    """The port is open for everybody, so the log must not be."""
    if joined:
        client, server = await listener.pair(Handlers())
        client._receiver.broker.sendEncoded(message)
        client._receiver.broker.sendEncoded(message)
        client._receiver.broker.transport.loseConnection()
        await asyncio.wait_for(server.lost, TIMEOUT)
    else:
        await send_until_closed(listener.port, PB + encode(message) + encode(message) + b"\x80\xff")
    assert not failures


@pytest.mark.parametrize("number", [b"x", -1, [7]], ids=str)
async def test_call_with_a_malformed_number_ends_the_connection(
    listener: Listener, failures: list[object], number: Any
) -> None:
    client, server = await listener.pair(Handlers())
    receiver = client._receiver
    receiver.broker.sendEncoded([b"message", number, receiver.luid, b"call", 1, [b"tuple", b"x"], [b"dictionary"]])
    await asyncio.wait_for(server.lost, TIMEOUT)
    assert not failures


@pytest.mark.parametrize("answer", [7, [b"list"], [b"module", b"os"], [b"tuple"]], ids=str)
async def test_answer_of_another_form_fails_the_call(listener: Listener, answer: Any) -> None:
    client, server = await listener.pair(Handlers())
    broker = client._receiver.broker
    broker.proto_message = lambda number, *_: broker.sendEncoded([b"answer", number, answer])
    with pytest.raises((Lost, InvalidRequest)):
        await asyncio.wait_for(server.call(ReadLog("n")), TIMEOUT)
    client.close()
    await asyncio.wait_for(server.lost, TIMEOUT)


async def test_calls_of_an_environment_wait_while_its_user_has_used_the_budget(
    listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "BURST", 20)
    monkeypatch.setattr(limits, "CALLS_PER_SECOND", 1e-3)
    monkeypatch.setattr(limits, "CALLS_PER_CONNECTION", 0)
    other, other_end = await listener.pair(Handlers())
    client, server = await listener.pair(Handlers(), hello=ENVIRONMENT)
    calls = [asyncio.create_task(client.call(StopNode("n"))) for _ in range(500)]
    await asyncio.gather(*calls[:10])
    for _ in range(3):  # a round trip of another peer: whatever the environment has sent meanwhile, waits
        assert await other.call(StopNode("n")) == Nothing()
    assert 10 <= sum(each.done() for each in calls) <= 20 + broker.Broker.slice_size
    server.close()
    await asyncio.wait_for(client.lost, TIMEOUT)
    await asyncio.gather(*calls, return_exceptions=True)
    await closed(other, other_end)


async def test_pings_do_not_use_the_budget_of_a_user_unless_they_are_a_flood(
    listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "CALLS_PER_SECOND", 1e-3)
    monkeypatch.setattr(limits, "CALLS_PER_CONNECTION", 0)
    client, server = await listener.pair(Handlers(), hello=ENVIRONMENT)
    budget = server._receiver.broker._budget
    assert budget.connections == 1
    used = budget._used
    for number in range(10):
        client._receiver.broker.ping()
        await client.call(StopNode("n"))  # when it is answered, the ping was handled
        assert budget._used - used == pytest.approx(number + 1 + number, abs=0.1), "the first ping is free"
    await closed(client, server)
    assert budget.connections == 0


async def test_burst_of_calls_is_answered_in_slices(listener: Listener) -> None:
    """So another peer waits for one slice, not for the whole burst."""
    other, other_end = await listener.pair(Handlers())
    client, server = await listener.pair(Handlers())
    calls = [asyncio.create_task(client.call(StopNode("n"))) for _ in range(2000)]
    await asyncio.sleep(0)
    await other.call(StopNode("n"))
    assert sum(each.done() for each in calls) < 1000
    await asyncio.gather(*calls)
    await closed(client, server)
    await closed(other, other_end)


async def test_calls_are_sent_at_once(listener: Listener) -> None:
    client, server = await listener.pair(Handlers())
    for end in (client, server):
        assert end._receiver.broker.transport.getTcpNoDelay()
    await closed(client, server)
