"""Pace of a topic for one receiver."""

from __future__ import annotations

import asyncio

import pytest

from endpoints.data.frames import Message
from endpoints.robot.pace import Pace
from rce.net.budget import INTERFACE, MB, OVERHEAD, Budget


def message(number: int, size: int = 1) -> Message:
    return Message(bytes(16), str(number), bytes(size))


def stop_clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Return the time of the running loop, in one element that the test sets."""
    now = [100.0]
    monkeypatch.setattr(asyncio.get_running_loop(), "time", lambda: now[0])
    return now


async def test_message_that_comes_too_early_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    stop_clock(monkeypatch)
    pace = Pace(60.0, 0, Budget(MB))
    assert pace.admits(message(1), lambda _: None)
    assert not pace.admits(message(2), lambda _: None)


async def test_newest_messages_wait_for_their_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    stop_clock(monkeypatch)
    pace, got = Pace(60.0, 2, Budget(MB)), list[str]()
    admitted = [pace.admits(message(number), lambda late: got.append(late.msg_id)) for number in range(5)]
    assert admitted == [True, False, False, False, False]
    for expected in (["3"], ["3", "4"]):
        assert pace._timer is not None
        assert pace._next == 120.0
        pace._deliver()  # as the timer would
        assert got == expected
    pace.close()


async def test_new_pace_counts_the_message_that_passed_in_its_interval(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = stop_clock(monkeypatch)
    old, equal, faster = Pace(60.0, 0, Budget(MB)), Pace(60.0, 0, Budget(MB)), Pace(10.0, 0, Budget(MB))
    assert old.admits(message(1), lambda _: None)
    for pace in (equal, faster):
        pace.follow(old)
        assert not pace.admits(message(2), lambda _: None)
    clock[0] = 110.0
    assert [pace.admits(message(3), lambda _: None) for pace in (equal, faster)] == [False, True]


async def test_timer_that_is_a_little_early_begins_the_next_interval(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = stop_clock(monkeypatch)
    pace = Pace(10.0, 1, Budget(MB))
    clock[0] = 109.9
    assert pace.admits(message(1), lambda _: None)
    clock[0] = 110.5
    assert not pace.admits(message(2), lambda _: None)
    pace.close()


async def test_receivers_at_one_rate_get_the_same_messages_whenever_they_began(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = stop_clock(monkeypatch)
    first, second = (Pace(10.0, 1, Budget(MB)) for _ in range(2))
    got: tuple[list[str], list[str]] = [], []
    for second_of_clock in range(34):
        clock[0] = 100.0 + second_of_clock
        for place, pace in enumerate((first, second)[: 1 if second_of_clock < 7 else 2]):
            if pace._timer is not None and clock[0] >= pace._next:
                pace._timer.cancel()
                pace._deliver()
            if pace.admits(message(second_of_clock), lambda late, place=place: got[place].append(late.msg_id)):  # type: ignore[misc]
                got[place].append(str(second_of_clock))
    assert got == (["0", "9", "19", "29"], ["7", "9", "19", "29"])
    for pace in (first, second):
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
