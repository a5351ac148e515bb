"""What somebody at the control port may say who is not known there."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest
from test_control import HELLO, LOCAL, Doorman
from twisted.internet.base import ReactorBase

from rce import broker
from rce.calls.watching import ReadLog
from rce.control import Handlers, connect, listen
from rce.errors import Lost

PB = b"\x02\x82pb"  # the dialect that a caller chooses first


@pytest.fixture
async def place(reactor: ReactorBase) -> AsyncIterator[tuple[ReactorBase, Doorman, int]]:
    doorman = Doorman()
    port = await listen(reactor, LOCAL, doorman)
    yield reactor, doorman, port.getHost().port  # type: ignore[misc]  # zope declares it without self
    await port.stopListening().asFuture(asyncio.get_running_loop())  # type: ignore[misc,union-attr]


async def heard_out(port: int, said: bytes) -> None:
    """Returns when the other side has closed."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(said)
    try:
        async with asyncio.timeout(20):
            while await reader.read(1000):
                pass
    except ConnectionError:
        pass
    writer.transport.abort()


@pytest.mark.parametrize(
    "said",
    [
        PB + b"\x01\x80" * 100,  # lists in lists
        PB + b"\x00\x00\x28\x80" + b"\x01\x81" * 10_000,  # a long list of numbers
        PB + b"\x00\x00\x28\x80" + (b"\x00\x00\x28\x82" + bytes(655_360)) * 8,  # of large strings
        b"GET / HTTP/1.1\r\nHost: " + b"x" * 100 + b"\r\n\r\n",
        PB + bytes(1000),
        PB + b"\x01\x82\xff",  # what is no call
    ],
    ids=["deep", "long", "large", "http", "zeros", "no call"],
)
async def test_who_is_not_known_may_say_little(place: tuple[ReactorBase, Doorman, int], said: bytes) -> None:
    reactor, doorman, port = place
    await heard_out(port, said)
    there, _ = await connect(reactor, f"tcp:127.0.0.1:{port}", HELLO, Handlers())
    here = await asyncio.wait_for(doorman.joined.get(), 10)
    there.close()
    await here.lost


async def test_who_says_nothing_is_not_kept(
    place: tuple[ReactorBase, Doorman, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(broker, "JOIN_WITHIN", 0.02)
    await heard_out(place[2], b"")


async def test_one_message_has_its_bounds_too(
    place: tuple[ReactorBase, Doorman, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    reactor, doorman, port = place
    there, _ = await connect(reactor, f"tcp:127.0.0.1:{port}", HELLO, Handlers())
    here = await asyncio.wait_for(doorman.joined.get(), 10)
    monkeypatch.setattr(broker, "MESSAGE_MOST", 1_000_000)
    for _ in range(5):
        with pytest.raises(Exception, match="does not answer"):
            await there.call(ReadLog("n" * 300_000))
    with pytest.raises(Lost):
        await there.call(ReadLog("n" * 1_100_000))
    await asyncio.wait_for(here.lost, 10)


async def test_many_messages_that_follow_closely_are_not_one(
    place: tuple[ReactorBase, Doorman, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    reactor, doorman, port = place
    there, _ = await connect(reactor, f"tcp:127.0.0.1:{port}", HELLO, Handlers())
    await asyncio.wait_for(doorman.joined.get(), 10)
    monkeypatch.setattr(broker, "MESSAGE_MOST", 1_000_000)
    calls = (there.call(ReadLog("n" * 300_000)) for _ in range(20))
    assert {type(each) for each in await asyncio.gather(*calls, return_exceptions=True)} != {Lost}
    with pytest.raises(Exception, match="does not answer"):
        await there.call(ReadLog("n"))
