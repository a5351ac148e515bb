"""The order in which plans are carried out, who is awaited, and what becomes real."""

from __future__ import annotations

import asyncio
from typing import Any, cast

import pytest
from hand_turned import HandTurnedLoop

from master.carrier import Carrier
from master.effects import Plan, Send, Settle
from rce.calls.call import Call, Nothing
from rce.calls.endpoints import CloseLink, DropParameter, StopNode, Sync, Unbind
from rce.control import Control
from rce.errors import InvalidRequest, Lost, NotFound, RceError, StartFailed, TimedOut, Unavailable


class Process:
    """The far side of a control connection: notes what arrives and answers when it is told to."""

    def __init__(self) -> None:
        self.arrived: list[Call[Any]] = []
        self._open: list[asyncio.Future[object]] = []

    async def call(self, call: Call[Any]) -> object:
        self.arrived.append(call)
        answer: asyncio.Future[object] = asyncio.get_running_loop().create_future()
        self._open.append(answer)
        return await answer

    def answer(self, result: object | RceError | None = None) -> None:
        """Answer the oldest open call."""
        answer = self._open.pop(0)
        if isinstance(result, RceError):
            answer.set_exception(result)
        else:
            answer.set_result(Nothing() if result is None else result)


class Desk:
    """A Carrier with two processes."""

    def __init__(self, hand: HandTurnedLoop) -> None:
        self.hand = hand
        self.heard: list[tuple[Call[Any], object]] = []
        self.a, self.b = Process(), Process()
        self.carrier = Carrier(self.prepare, lambda send, result: self.heard.append((send.call, result)))
        self.carrier.controls = {"a": cast(Control, self.a), "b": cast(Control, self.b)}

    async def prepare(self, send: Send) -> Send:
        return send

    def carry(self, *plan: list[Send | Settle]) -> asyncio.Task[None]:
        whole: Plan = list(plan)
        return self.hand.do(lambda: self.carrier.carry(whole))

    def answer(self, process: Process, result: object | RceError | None = None) -> None:
        self.hand.do(lambda: process.answer(result))

    def wait(self, key: str, seconds: float = 60) -> asyncio.Task[None]:
        return self.hand.begin(self.carrier.wait(key, seconds))

    def settle(self, key: str, error: RceError | None = None) -> bool:
        return self.hand.do(lambda: self.carrier.settle(key, error))


@pytest.fixture
def desk(hand: HandTurnedLoop) -> Desk:
    return Desk(hand)


def stop(to: str, node: str, key: str | None = None) -> Send:
    return Send(to, StopNode(node), node if key is None else key)


# --- order ------------------------------------------------------------------------------------------------------------


def test_a_sequence_is_one_after_the_other(desk: Desk) -> None:
    task = desk.carry([stop("a", "1"), stop("b", "2"), Settle("done")])
    assert (len(desk.a.arrived), len(desk.b.arrived)) == (1, 0)
    desk.answer(desk.a)
    assert len(desk.b.arrived) == 1
    assert not desk.carrier.is_real("done")
    desk.answer(desk.b)
    assert desk.carrier.is_real("done")
    assert task.result() is None


def test_sequences_run_beside_each_other(desk: Desk) -> None:
    desk.carry([stop("a", "1")], [stop("a", "2")])
    assert desk.a.arrived == [StopNode("1"), StopNode("2")]


def test_calls_about_one_thing_keep_their_order_over_plans(desk: Desk) -> None:
    desk.carry([stop("b", "slow"), stop("a", "first", "thing")])
    desk.carry([stop("a", "second", "thing")])
    desk.carry([stop("a", "other")])
    assert desk.a.arrived == [StopNode("other")]
    desk.answer(desk.b)
    assert desk.a.arrived == [StopNode("other"), StopNode("first")]
    desk.answer(desk.a)
    desk.answer(desk.a)
    assert desk.a.arrived[2:] == [StopNode("second")]


def test_the_same_thing_at_another_process_does_not_wait(desk: Desk) -> None:
    desk.carry([Send("a", CloseLink("l"), "l")], [Send("b", CloseLink("l"), "l")])
    assert (len(desk.a.arrived), len(desk.b.arrived)) == (1, 1)


def test_what_follows_a_call_about_everything_waits_for_its_answer(desk: Desk) -> None:
    """A route is told only after the Sync that makes its interface."""
    desk.carry([Send("a", Sync(), "")], [stop("a", "1")])
    desk.carry([stop("a", "2"), stop("b", "3")])
    assert (desk.a.arrived, desk.b.arrived) == ([Sync()], [])
    desk.answer(desk.a)
    assert desk.a.arrived == [Sync(), StopNode("1"), StopNode("2")]


def test_the_next_call_goes_out_after_a_failure_too(desk: Desk) -> None:
    failing = desk.carry([stop("a", "1", "k"), stop("a", "skipped", "s")])
    desk.carry([stop("a", "2", "k")])
    desk.carry([stop("a", "3", "s")])
    desk.answer(desk.a, NotFound("no node"))
    assert desk.a.arrived == [StopNode("1"), StopNode("2"), StopNode("3")]
    assert isinstance(failing.exception(), NotFound)


# --- errors -----------------------------------------------------------------------------------------------------------


def test_a_failure_ends_its_sequence_and_no_other(desk: Desk) -> None:
    task = desk.carry([stop("a", "1"), Settle("one")], [stop("b", "2"), stop("b", "3"), Settle("two")])
    error = StartFailed("exit status 1")
    desk.answer(desk.a, error)
    assert not task.done()
    desk.answer(desk.b)
    desk.answer(desk.b)
    assert task.exception() is error
    assert not desk.carrier.is_real("one")
    assert desk.carrier.is_real("two")
    assert desk.heard[0] == (StopNode("1"), error)


def test_the_error_of_the_first_sequence_is_raised(desk: Desk) -> None:
    task = desk.carry([stop("a", "1")], [stop("b", "2")])
    desk.answer(desk.b, InvalidRequest("later in the plan"))
    desk.answer(desk.a, NotFound("first in the plan"))
    assert isinstance(task.exception(), NotFound)


@pytest.mark.parametrize("lost", [Lost("gone"), Unavailable("link did not open")])
def test_who_is_away_misses_its_call_and_the_others_get_theirs(desk: Desk, lost: RceError) -> None:
    task = desk.carry([stop("a", "1"), stop("b", "2"), Settle("all")])
    desk.answer(desk.a, lost)
    assert desk.b.arrived == [StopNode("2")]
    desk.answer(desk.b)
    assert task.result() is None
    assert not desk.carrier.is_real("all")


def test_a_process_that_never_joined_is_away(desk: Desk) -> None:
    task = desk.carry([stop("nobody", "1"), stop("b", "2")])
    desk.answer(desk.b)
    assert task.result() is None


def test_a_call_that_waited_is_not_for_the_process_that_is_back(desk: Desk) -> None:
    """It has had its Sync, which is newer."""
    desk.carry([stop("a", "1", "k")])
    desk.carry([stop("a", "2", "k")])
    back = Process()
    desk.carrier.controls["a"] = cast(Control, back)
    desk.answer(desk.a, Lost("gone"))
    assert (desk.a.arrived, back.arrived) == ([StopNode("1")], [])


def test_the_result_is_told_with_its_call(desk: Desk) -> None:
    desk.carry([Send("a", Unbind("i"), "i")])
    desk.answer(desk.a)
    assert desk.heard == [(Unbind("i"), Nothing())]


def test_a_call_is_completed_before_it_leaves(hand: HandTurnedLoop) -> None:
    desk = Desk(hand)

    async def prepare(send: Send) -> Send:
        return Send(send.to, DropParameter("made"), send.key)

    desk.carrier = Carrier(prepare, lambda send, result: None)
    desk.carrier.controls = {"a": cast(Control, desk.a)}
    desk.carry([stop("a", "1")])
    assert desk.a.arrived == [DropParameter("made")]


# --- what is real -----------------------------------------------------------------------------------------------------


def test_waiting_for_what_is_real_already(desk: Desk) -> None:
    assert desk.settle("x") is False
    assert desk.wait("x").result() is None


def test_all_who_wait_are_told(desk: Desk) -> None:
    waiting = [desk.wait("x"), desk.wait("x")]
    assert desk.settle("x") is True
    assert [task.result() for task in waiting] == [None, None]


def test_all_who_wait_are_told_why_not(desk: Desk) -> None:
    waiting = [desk.wait("x"), desk.wait("x")]
    error = StartFailed("broken")
    assert desk.settle("x", error) is True
    assert [task.exception() for task in waiting] == [error, error]
    assert not desk.carrier.is_real("x")
    assert desk.settle("x", error) is False


def test_one_who_gives_up_does_not_take_the_others_along(desk: Desk, hand: HandTurnedLoop) -> None:
    short, long = desk.wait("Node ann/brain/N1", 5), desk.wait("Node ann/brain/N1", 50)
    hand.turn(4.9)
    assert not short.done()
    hand.turn(0.2)
    assert str(short.exception()) == "node ann/brain/N1 did not come up within 5 s"
    assert isinstance(short.exception(), TimedOut)
    desk.settle("Node ann/brain/N1")
    assert long.result() is None


@pytest.mark.parametrize("end", ["cancel", "time"])
def test_who_has_given_up_is_not_waiting(desk: Desk, hand: HandTurnedLoop, end: str) -> None:
    task = desk.wait("x", 5)
    if end == "cancel":
        task.cancel()
        hand.settle()
    else:
        hand.turn(5)
        assert task.exception()
    assert desk.settle("x", StartFailed("nobody hears this")) is False


def test_what_is_forgotten_is_waited_for_again(desk: Desk) -> None:
    desk.settle("x")
    desk.carrier.forget("x")
    task = desk.wait("x")
    assert not task.done()
    desk.settle("x")
    assert task.done()


def test_close_ends_what_is_under_way(desk: Desk, hand: HandTurnedLoop) -> None:
    task = desk.carry([stop("a", "1"), Settle("x")])
    closing = hand.begin(desk.carrier.close())
    assert closing.done()
    assert task.cancelled()
    assert not desk.carrier.is_real("x")
