"""What links over real sockets carry, in which turns and at which rates, and how they end."""

from __future__ import annotations

import asyncio
import gc

import pytest
from ends import KEY, A, B, End, Listener
from raw_robot import WAIT

from endpoints.frames import Message
from endpoints.link import LoopLink
from endpoints.throttle import BURST, LEAST, Throttle


async def test_messages_go_both_ways_whole_and_in_order(pair: tuple[End, End]) -> None:
    here, there = pair
    for end, other in ((here, there), (there, here)):
        for number in range(100):
            end.link.send(Message(A, str(number), b"x" * number), None)
        end.link.send(Message(B, "large", b"y" * 3_000_000), None)
        await other.until(lambda other=other: len(other.got) == 101)  # type: ignore[misc]
        assert sorted(message.msg_id for message in end.left) == sorted(message.msg_id for message in other.got)
        assert [m.msg_id for m in other.got if m.source == A] == [str(number) for number in range(100)]
        assert bytes(next(m for m in other.got if m.source == B).payload) == b"y" * 3_000_000


async def test_an_end_that_breaks_is_reported_once_and_one_that_is_closed_never(pair: tuple[End, End]) -> None:
    here, there = pair
    here.link.close()
    await there.until(lambda: bool(there.lost))
    there.link.fail("again")
    there.link.close()
    await asyncio.sleep(0)
    assert (here.lost, len(there.lost)) == ([], 1)


async def test_who_waits_for_room_on_a_link_that_broke_is_let_go_when_it_is_closed(pair: tuple[End, End]) -> None:
    here, there = pair
    there.link.close()
    await here.until(lambda: bool(here.lost))
    for number in range(20):
        here.link.send(Message(A, str(number), b""), None)
    room = here.link.room(A)
    assert room is not None
    here.link.close()
    assert room.done()
    gc.collect()


async def test_a_paused_end_takes_nothing_until_then_and_then_all(pair: tuple[End, End]) -> None:
    here, there = pair
    until: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    there.link.pause(until)
    for number in range(60):
        here.link.send(Message(A, str(number), bytes(1_000_000)), None)
    room = here.link.room(A)
    assert room is not None, "the sender is asked to wait"
    assert not there.got
    until.set_result(None)
    await asyncio.wait_for(room, WAIT)
    await there.until(lambda: len(there.got) == 60)
    assert [m.msg_id for m in there.got] == [str(number) for number in range(60)]


async def test_what_comes_in_is_taken_at_the_rate_of_its_sender(port: tuple[Listener, list[str]]) -> None:
    """Over two links together, and all of it arrives."""
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
        await there.until(lambda there=there: len(there.got) == 1)  # type: ignore[misc]
    assert asyncio.get_running_loop().time() - began > (2 * size / rate - BURST) * 0.9 - 0.1
    for here, there in ends:
        here.link.close()
        there.link.close()


async def test_a_pause_outlasts_the_wait_for_the_rate(port: tuple[Listener, list[str]]) -> None:
    listener, addresses = port
    here, there = End(), End(throttle=Throttle(1_000_000))
    listener.expect(there.link, KEY)
    await listener.dial(here.link, KEY, addresses)
    here.link.send(Message(A, "1", bytes(200_000)), None)
    await there.until(lambda: len(there.got) == 1)  # and now it waits, having taken more than a tenth of a second's
    until: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    there.link.pause(until)
    await asyncio.sleep(0.3)
    here.link.send(Message(A, "2", b""), None)
    await asyncio.sleep(0.05)
    assert len(there.got) == 1
    until.set_result(None)
    await there.until(lambda: len(there.got) == 2)
    here.link.close()
    there.link.close()


def test_a_throttle() -> None:
    now = 0.0
    throttle = Throttle(1_000_000, lambda: now)
    assert throttle.take(100_000) == 0  # a tenth of a second's worth goes at once
    assert throttle.take(500_000) == 0.5
    now = 0.5
    assert throttle.take(0) == 0
    now = 100
    assert throttle.take(100_000) == 0
    assert throttle.take(1_000) == pytest.approx(0.001)
    assert Throttle(1, lambda: now).take(LEAST) == 0


async def test_a_flood_does_not_starve_the_loop(pair: tuple[End, End]) -> None:
    """While one side sends as fast as it can, others on the loop get their turns."""
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
    await there.until(lambda: len(there.got) == 100)
    task.cancel()
    assert turns > 10


async def test_a_loop_link_queues_while_it_is_paused() -> None:
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
    room = link.room(B)
    assert room is not None
    until.set_result(None)
    await asyncio.wait_for(room, WAIT)
    assert sorted(got[1:]) == sorted(["2", "3", *map(str, range(10))])
