"""Pace of a topic for one receiver."""

from __future__ import annotations

import asyncio

from endpoints.data.frames import Message
from endpoints.robot.pace import Pace
from rce.net.budget import INTERFACE, MB, OVERHEAD, Budget


def message(number: int, size: int = 1) -> Message:
    return Message(bytes(16), str(number), bytes(size))


async def test_message_that_comes_too_early_is_dropped() -> None:
    pace = Pace(60.0, 0, Budget(MB))
    assert pace.admits(message(1), lambda _: None)
    assert not pace.admits(message(2), lambda _: None)


async def test_newest_messages_wait_for_their_turn() -> None:
    pace, got = Pace(0.01, 2, Budget(MB)), list[str]()
    done = asyncio.Event()

    def deliver(late: Message) -> None:
        got.append(late.msg_id)
        if late.msg_id == "4":
            done.set()

    assert [pace.admits(message(number), deliver) for number in range(5)] == [True, False, False, False, False]
    await asyncio.wait_for(done.wait(), 30)
    assert got == ["3", "4"]
    pace.close()


async def test_messages_that_wait_are_bounded_in_bytes() -> None:
    budget = Budget(INTERFACE, spare=1)
    pace = Pace(60.0, 100, budget)
    for number in range(4):
        pace.admits(message(number, INTERFACE // 2), lambda _: None)
        assert budget.used <= INTERFACE // 2 + OVERHEAD
    pace.close()
    assert budget.used == 0


async def test_messages_that_wait_make_room_for_others_of_a_larger_budget() -> None:
    session = Budget(MB)
    pace, other = (Pace(60.0, 100, Budget(MB, session, 1)) for _ in range(2))
    got = list[str]()
    for number in range(2):
        pace.admits(message(number, 600_000), lambda late: got.append(late.msg_id))
        other.admits(message(number, 500_000), lambda _: None)
    session.shrink()
    assert (pace.charged, other.charged) == (0, 500_000 + OVERHEAD)
    pace._deliver()  # as the timer would
    assert not got
    other.close()
