"""Links over real sockets: order, back-pressure, rate limits, and how they end."""

from __future__ import annotations

import asyncio
import gc
from typing import Any, cast
from unittest.mock import Mock

import pytest
from twisted.logger import LogEvent, LogLevel, globalLogPublisher

from endpoints.data.frames import Message, pieces
from endpoints.data.link import GATHERED, LoopLink, StreamLink
from endpoints.data.throttle import BURST, Throttle
from tests.support.endpoints.ends import A, B, End, Listener
from tests.support.endpoints.raw_robot import WAIT
from tests.support.hand_turned import HandTurnedLoop


async def test_messages_pass_complete_and_in_order_both_ways(pair: tuple[End, End]) -> None:
    here, there = pair
    for end, other in ((here, there), (there, here)):
        for number in range(100):
            end.link.send(Message(A, str(number), b"x" * number), None)
        end.link.send(Message(B, "large", b"y" * 3_000_000), None)
        await other.until_received(101)
        assert sorted(message.msg_id for message in end.sent) == sorted(message.msg_id for message in other.received)
        assert [m.msg_id for m in other.received if m.source == A] == [str(number) for number in range(100)]
        assert bytes(next(m for m in other.received if m.source == B).payload) == b"y" * 3_000_000


async def test_broken_link_is_reported_once_and_closed_link_never(pair: tuple[End, End]) -> None:
    here, there = pair
    here.link.close()
    await there.until(lambda: bool(there.lost))
    there.link.fail("again")
    there.link.close()
    await asyncio.sleep(0)
    assert (here.lost, len(there.lost)) == ([], 1)


@pytest.mark.parametrize(("error", "level"), [(None, LogLevel.info), (OSError("reset"), LogLevel.warn)])
async def test_only_link_that_broke_is_a_warning(
    pair: tuple[End, End], error: Exception | None, level: LogLevel
) -> None:
    """A link that its other side closed was not needed any more, as a rule."""
    here, _ = pair
    events: list[LogEvent] = []
    globalLogPublisher.addObserver(cast(Any, events.append))
    try:
        here.link.connection_lost(error)
    finally:
        globalLogPublisher.removeObserver(cast(Any, events.append))
    assert [event["log_level"] for event in events] == [level]
    assert len(here.lost) == 1


async def test_close_of_broken_link_releases_waiting_senders(pair: tuple[End, End]) -> None:
    here, there = pair
    there.link.close()
    await here.until(lambda: bool(here.lost))
    for number in range(20):
        here.link.send(Message(A, str(number), b""), None)
    room = here.link.wait_for_room(A)
    assert room is not None
    here.link.close()
    assert room.done()
    gc.collect()


async def test_paused_link_delivers_everything_after_pause(pair: tuple[End, End]) -> None:
    here, there = pair
    until: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    there.link.pause(until)
    for number in range(60):
        here.link.send(Message(A, str(number), bytes(1_000_000)), None)
    room = here.link.wait_for_room(A)
    assert room is not None, "the sender has to wait"
    assert not there.received
    until.set_result(None)
    await asyncio.wait_for(room, WAIT)
    await there.until_received(60)
    assert [m.msg_id for m in there.received] == [str(number) for number in range(60)]


def attached() -> tuple[StreamLink, Mock]:
    """Return a link and its transport."""
    link, transport = End().link, Mock(is_closing=lambda: False, get_extra_info=lambda _: None)
    link.attach(transport)
    return link, transport


def test_small_messages_are_gathered_and_large_ones_take_them_along(hand: HandTurnedLoop) -> None:
    link, transport = hand.do(attached)
    written: list[int] = []
    transport.writelines = lambda buffers: written.append(sum(map(len, buffers)))

    def send(size: int) -> int:
        message = Message(A, "m", bytes(size))
        link.send(message, None)
        return sum(len(buffer) for piece in pieces(message, 0) for buffer in piece)

    link.gather()
    small = send(10) + send(20)
    assert written == []
    large = send(GATHERED)
    assert written == [small + large]
    last = send(30)
    link.flush()
    assert written == [small + large, last]
    alone = send(40)
    assert written == [small + large, last, alone]


def test_gathered_messages_of_a_lost_link_are_not_written(hand: HandTurnedLoop) -> None:
    link, transport = hand.do(attached)
    link.gather()
    link.send(Message(A, "m", b"x"), None)
    hand.do(lambda: link.connection_lost(None))
    link.flush()
    transport.writelines.assert_not_called()


async def test_links_of_sender_share_its_rate_limit(port: tuple[Listener, list[str]]) -> None:
    listener, addresses = port
    rate, size = 4_000_000, 1_000_000
    throttle = Throttle(rate)
    ends = []
    for number in range(2):
        key = bytes([number]) * 16
        here, there = End(), End(throttle=throttle)
        listener.expect(there.link, key)
        await listener.dial(here.link, key, addresses)
        ends.append((here, there))
    began = asyncio.get_running_loop().time()
    for here, _ in ends:
        here.link.send(Message(A, "1", bytes(size)), None)
    for _, there in ends:
        await there.until_received(1)
    assert asyncio.get_running_loop().time() - began > (2 * size / rate - BURST) * 0.9 - 0.1
    for here, there in ends:
        here.link.close()
        there.link.close()


class Waits:
    """Throttle that asks for fixed waits, one for each chunk of bytes received."""

    def __init__(self, *seconds: float) -> None:
        self._left = list(seconds)

    def consume(self, amount: int) -> float:
        return self._left.pop(0) if self._left else 0.0


def waiting(transport: Mock) -> tuple[StreamLink, asyncio.Future[None]]:
    """Return a link that waits for a second because of its rate limit, and is paused until the future is done."""
    link = End(throttle=cast(Throttle, Waits(1.0))).link
    link.attach(transport)
    link.buffer_updated(0)
    until: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    link.pause(until)
    return link, until


def test_pause_outlasts_wait_of_rate_limit(hand: HandTurnedLoop) -> None:
    transport = Mock(is_closing=lambda: False, get_extra_info=lambda _: None)
    link, until = hand.do(lambda: waiting(transport))
    hand.turn(1.0)
    transport.pause_reading.assert_called_once()
    transport.resume_reading.assert_not_called()
    hand.do(lambda: until.set_result(None))
    transport.resume_reading.assert_called_once()
    hand.do(link.close)


def test_wait_of_rate_limit_outlasts_pause(hand: HandTurnedLoop) -> None:
    transport = Mock(is_closing=lambda: False, get_extra_info=lambda _: None)
    link, until = hand.do(lambda: waiting(transport))
    hand.do(lambda: until.set_result(None))
    transport.resume_reading.assert_not_called()
    hand.turn(1.0)
    transport.resume_reading.assert_called_once()
    hand.do(link.close)


async def test_flood_does_not_starve_other_tasks(pair: tuple[End, End]) -> None:
    here, there = pair
    turns = 0

    async def other() -> None:
        nonlocal turns
        while True:
            await asyncio.sleep(0)
            turns += 1

    task = asyncio.create_task(other())
    for number in range(100):
        here.link.send(Message(A, str(number), bytes(1_000_000)), None)
    await there.until_received(100)
    task.cancel()
    assert turns > 10


async def test_loop_link_queues_messages_while_paused() -> None:
    got: list[str] = []
    link = LoopLink("l", lambda message, link: got.append(message.msg_id), lambda message: None)
    assert link.opened.done()
    link.send(Message(A, "first", b""), 2)
    until: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    link.pause(until)
    dropped = [link.send(Message(A, str(number), b""), 2) for number in range(4)]
    assert (got, dropped, link.backlog(A)) == (["first"], [0, 0, 1, 1], 2)
    for number in range(10):
        link.send(Message(B, str(number), b""), None)
    room = link.wait_for_room(B)
    assert room is not None
    until.set_result(None)
    await asyncio.wait_for(room, WAIT)
    assert sorted(got[1:]) == sorted(["2", "3", *map(str, range(10))])
