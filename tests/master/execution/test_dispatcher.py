"""Dispatcher: turns of calls about one thing, connections that are replaced meanwhile, and single questions."""

from __future__ import annotations

import asyncio
from typing import Any, cast

import pytest

from master.execution.dispatcher import Dispatcher, Turn
from master.graph.effects import Send
from master.graph.records import Ref
from rce.control.calls.call import Call, Nothing
from rce.control.calls.endpoints import StopNode
from rce.control.calls.watching import ReadMetrics
from rce.control.connection import Control
from rce.errors import NotFound, RceError, TimedOut, Unavailable
from tests.support.hand_turned import HandTurnedLoop

NODE, OTHER = Ref("node", "ann/brain/n"), Ref("node", "ann/brain/other")


class Answering:
    """Control connection that gives one answer to everything; without one it never answers."""

    def __init__(self, answer: object = None) -> None:
        self.answer = answer

    async def call(self, call: Call[Any]) -> object:
        if self.answer is None:
            await asyncio.get_running_loop().create_future()
        if isinstance(self.answer, RceError):
            raise self.answer
        return self.answer


class Line:
    """A dispatcher, with processes `a` and `b` connected."""

    def __init__(self, hand: HandTurnedLoop) -> None:
        self.hand = hand
        self.dispatcher = Dispatcher()
        self.a = self.connect("a")
        self.connect("b")

    def connect(self, name: str, answer: object = None) -> Control:
        control = cast(Control, Answering(answer))
        self.dispatcher.controls[name] = control
        return control

    def reserve(self, to: str, about: Ref | None) -> Turn:
        return self.hand.do(lambda: self.dispatcher.reserve(Send(to, StopNode("n"), about)))

    def wait(self, turn: Turn) -> asyncio.Task[Control]:
        return self.hand.begin(self.dispatcher.wait(turn))

    def end(self, turn: Turn) -> None:
        self.hand.do(turn.end)

    def ask(self, process: str) -> asyncio.Task[Any]:
        return self.hand.begin(self.dispatcher.ask(process, ReadMetrics(), 5))


@pytest.fixture
def line(hand: HandTurnedLoop) -> Line:
    return Line(hand)


# --- turns ------------------------------------------------------------------------------------------------------------


def test_turn_comes_when_the_one_before_it_has_ended(line: Line) -> None:
    first, second = line.reserve("a", NODE), line.reserve("a", NODE)
    waiting = line.wait(second)
    assert line.wait(first).result() is line.a
    assert not waiting.done()
    line.end(first)
    assert waiting.result() is line.a


@pytest.mark.parametrize(("to", "about"), [("a", OTHER), ("b", NODE)])
def test_calls_about_other_things_or_at_other_processes_do_not_wait(line: Line, to: str, about: Ref) -> None:
    line.reserve("a", NODE)
    assert line.wait(line.reserve(to, about)).done()


def test_call_about_everything_holds_up_later_calls_at_its_process_only(line: Line) -> None:
    everything = line.reserve("a", None)
    later = [line.wait(line.reserve("a", about)) for about in (NODE, OTHER, None)]
    assert line.wait(line.reserve("b", NODE)).done()
    assert not any(turn.done() for turn in later)
    line.end(everything)
    assert [turn.done() for turn in later] == [True, True, True]


def test_ended_turns_are_forgotten(line: Line) -> None:
    first, second = line.reserve("a", NODE), line.reserve("a", NODE)
    line.end(first)
    assert list(line.dispatcher._last.values()) == [second]
    line.end(second)
    line.end(second)
    assert line.dispatcher._last == {}


def test_process_that_is_away_at_the_reservation_is_unavailable(line: Line) -> None:
    """It joins with a Sync, which is newer than the call."""
    turn = line.reserve("c", NODE)
    line.connect("c")
    assert isinstance(line.wait(turn).exception(), Unavailable)


def test_process_that_joined_again_since_the_reservation_is_unavailable(line: Line) -> None:
    first, second = line.reserve("a", NODE), line.reserve("a", NODE)
    waiting = line.wait(second)
    line.connect("a")
    line.end(first)
    assert isinstance(waiting.exception(), Unavailable)


def test_settled_waits_for_the_turns_that_were_reserved_before(line: Line) -> None:
    first, second = line.reserve("a", NODE), line.reserve("a", NODE)
    settled = line.hand.begin(line.dispatcher.settled("a", NODE))
    line.reserve("a", NODE)
    line.end(first)
    assert not settled.done()
    line.end(second)
    assert settled.done()


@pytest.mark.parametrize(("process", "about"), [("a", OTHER), ("b", NODE)])
def test_what_has_no_turns_is_settled(line: Line, process: str, about: Ref) -> None:
    line.reserve("a", NODE)
    assert line.hand.begin(line.dispatcher.settled(process, about)).done()


# --- questions --------------------------------------------------------------------------------------------------------


def test_answer_to_a_question_is_returned(line: Line) -> None:
    line.reserve("c", None)
    line.connect("c", Nothing())
    assert line.ask("c").result() == Nothing()


def test_refused_question_raises_the_error_of_the_process(line: Line) -> None:
    error = NotFound("no such thing")
    line.connect("c", error)
    assert line.ask("c").exception() is error


def test_question_to_a_process_that_is_away_is_unavailable(line: Line) -> None:
    assert isinstance(line.ask("c").exception(), Unavailable)


def test_question_without_an_answer_times_out(line: Line) -> None:
    asked = line.ask("a")
    line.hand.turn(4.9)
    assert not asked.done()
    line.hand.turn(0.2)
    assert isinstance(asked.exception(), TimedOut)
    assert str(asked.exception()) == "a did not answer within 5 s"
