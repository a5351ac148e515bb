"""Readiness: who waits for a reference hears when it is ready, why it never will be, or that time is over."""

from __future__ import annotations

import asyncio

import pytest

from master.execution.readiness import Readiness
from master.graph.records import Ref
from rce.errors import StartFailed, TimedOut
from tests.support.hand_turned import HandTurnedLoop

NODE = Ref("node", "ann/brain/N1")


class Desk:
    """Readiness in a loop whose time is turned by hand."""

    def __init__(self, hand: HandTurnedLoop) -> None:
        self.hand = hand
        self.readiness = Readiness()

    def wait(self, seconds: float = 60) -> asyncio.Task[None]:
        return self.hand.begin(self.readiness.wait(NODE, seconds))

    def mark_ready(self) -> None:
        self.hand.do(lambda: self.readiness.mark_ready(NODE))

    def fail(self, error: StartFailed) -> bool:
        return self.hand.do(lambda: self.readiness.fail(NODE, error))


@pytest.fixture
def desk(hand: HandTurnedLoop) -> Desk:
    return Desk(hand)


def test_waiting_for_a_ready_reference_returns_at_once(desk: Desk) -> None:
    desk.mark_ready()
    assert desk.wait().result() is None


def test_marking_ready_wakes_all_waiters(desk: Desk) -> None:
    waiting = [desk.wait(), desk.wait()]
    desk.mark_ready()
    assert [task.result() for task in waiting] == [None, None]
    assert desk.readiness.is_ready(NODE)


def test_failure_is_raised_in_all_waiters(desk: Desk) -> None:
    waiting = [desk.wait(), desk.wait()]
    error = StartFailed("broken")
    assert desk.fail(error) is True
    assert [task.exception() for task in waiting] == [error, error]
    assert not desk.readiness.is_ready(NODE)
    assert desk.fail(error) is False


def test_release_wakes_waiters_without_an_error(desk: Desk) -> None:
    task = desk.wait()
    desk.hand.do(lambda: desk.readiness.release(NODE))
    assert task.result() is None
    assert not desk.readiness.is_ready(NODE)


def test_timeout_of_one_waiter_does_not_affect_the_others(desk: Desk, hand: HandTurnedLoop) -> None:
    short, long = desk.wait(5), desk.wait(50)
    hand.turn(4.9)
    assert not short.done()
    hand.turn(0.2)
    assert str(short.exception()) == "node ann/brain/N1 did not come up within 5 s"
    assert isinstance(short.exception(), TimedOut)
    desk.mark_ready()
    assert long.result() is None


@pytest.mark.parametrize("end", ["cancel", "time"])
def test_cancelled_and_timed_out_waiters_are_forgotten(desk: Desk, hand: HandTurnedLoop, end: str) -> None:
    task = desk.wait(5)
    if end == "cancel":
        task.cancel()
        hand.settle()
    else:
        hand.turn(5)
        assert task.exception()
    assert desk.readiness.waiters() == 0
    assert desk.fail(StartFailed("nobody hears this")) is False


def test_forgotten_reference_is_waited_for_again(desk: Desk) -> None:
    desk.mark_ready()
    desk.readiness.forget(NODE)
    task = desk.wait()
    assert not task.done()
    desk.mark_ready()
    assert task.done()


def test_observers_hear_of_changes_only(desk: Desk) -> None:
    seen: list[Ref] = []
    desk.readiness.observers.append(seen.append)
    desk.mark_ready()
    desk.mark_ready()
    desk.readiness.forget(NODE)
    desk.readiness.forget(NODE)
    assert seen == [NODE, NODE]
