"""Limits of the control port for peers that have not joined, and for the size of a message."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest
from twisted.internet.base import ReactorBase

from rce.control import broker
from rce.control.calls.watching import ReadLog
from rce.control.connection import Handlers
from rce.errors import InvalidRequest, Lost
from tests.support.control import TIMEOUT, Listener, closed, listening

PB = b"\x02\x82pb"  # the protocol dialect that a client chooses first


@pytest.fixture
async def listener(reactor: ReactorBase) -> AsyncIterator[Listener]:
    async with listening(reactor) as listener:
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


async def test_unjoined_connection_is_closed_after_the_timeout(
    listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(broker, "JOIN_TIMEOUT", 0.02)
    await send_until_closed(listener.port, b"")


async def test_message_size_is_limited_after_joining(listener: Listener, monkeypatch: pytest.MonkeyPatch) -> None:
    client, server = await listener.pair(Handlers())
    monkeypatch.setattr(broker, "MAX_MESSAGE_BYTES", 1_000_000)
    for _ in range(5):
        with pytest.raises(InvalidRequest, match="does not answer"):
            await client.call(ReadLog("n" * 300_000))
    with pytest.raises(Lost):
        await client.call(ReadLog("n" * 1_100_000))
    await asyncio.wait_for(server.lost, TIMEOUT)


async def test_size_limit_applies_to_each_message_of_a_burst(
    listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    client, server = await listener.pair(Handlers())
    monkeypatch.setattr(broker, "MAX_MESSAGE_BYTES", 1_000_000)
    calls = (client.call(ReadLog("n" * 300_000)) for _ in range(20))
    assert {type(each) for each in await asyncio.gather(*calls, return_exceptions=True)} == {InvalidRequest}
    await closed(client, server)
