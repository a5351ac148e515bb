"""Plans: the order of their calls, what they mark ready, and the answers that they return."""

from __future__ import annotations

import asyncio
from typing import Any, cast

import pytest
from msgspec.structs import replace

from master.execution.effect_runner import Answer, EffectRunner, raise_first_error
from master.graph.effects import MarkReady, Plan, Send
from master.graph.records import Environment, EnvironmentOptions, Ref
from master.graph.state import State
from rce.control.calls.call import Call, Nothing
from rce.control.calls.endpoints import CloseLink, StopNode, Sync, Unbind
from rce.control.calls.environments import EnvironmentSpec, StartEnvironment
from rce.control.connection import Control
from rce.errors import DiskFull, InvalidRequest, Lost, NotFound, RceError, StartFailed, Unavailable
from rce.protocol.messages import ContainerData
from tests.support.hand_turned import HandTurnedLoop
from tests.support.master.desk import stored


class Process:
    """Other side of a control connection: records calls, and answers when the test says so."""

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


class Tokens:
    """Join tokens that are only noted."""

    def __init__(self) -> None:
        self.issued: list[tuple[str, str]] = []
        self.fails: RceError | None = None

    async def forget(self, process: str) -> None:
        self.issued.append(("forget", process))

    async def renew(self, process: str, role: str, token: str) -> None:
        if self.fails is not None:
            raise self.fails
        self.issued.append((process, token))


class Storage:
    """A store that has nothing to do."""

    def save(self, state: State) -> asyncio.Future[None]:
        return stored()


class Desk:
    """An effect runner with two processes."""

    def __init__(self, hand: HandTurnedLoop) -> None:
        self.hand = hand
        self.a, self.b = Process(), Process()
        self.tokens = Tokens()
        self.runner = EffectRunner(State(), cast(Any, Storage()), cast(Any, self.tokens), None)
        self.runner.dispatcher.controls |= {"a": cast(Control, self.a), "b": cast(Control, self.b)}

    def run(self, *plan: list[Send | MarkReady]) -> asyncio.Task[list[Answer]]:
        whole: Plan = list(plan)
        return self.hand.do(lambda: self.runner.run(whole))

    def answer(self, process: Process, result: object | RceError | None = None) -> None:
        self.hand.do(lambda: process.answer(result))

    def is_ready(self, name: str) -> bool:
        return self.runner.readiness.is_ready(thing(name))


@pytest.fixture
def desk(hand: HandTurnedLoop) -> Desk:
    return Desk(hand)


def thing(name: str) -> Ref:
    return Ref("thing", name)


def ready(name: str) -> MarkReady:
    return MarkReady(thing(name))


def stop(to: str, node: str, about: str | None = None) -> Send:
    return Send(to, StopNode(node), thing(node if about is None else about))


def results(task: asyncio.Task[list[Answer]]) -> list[object]:
    return [answer.result for answer in task.result()]


# --- order ------------------------------------------------------------------------------------------------------------


def test_steps_of_a_sequence_run_in_order(desk: Desk) -> None:
    task = desk.run([stop("a", "1"), stop("b", "2"), ready("done")])
    assert (len(desk.a.arrived), len(desk.b.arrived)) == (1, 0)
    desk.answer(desk.a)
    assert len(desk.b.arrived) == 1
    assert not desk.is_ready("done")
    desk.answer(desk.b)
    assert desk.is_ready("done")
    assert results(task) == [Nothing()] * len(task.result())


def test_sequences_run_concurrently(desk: Desk) -> None:
    desk.run([stop("a", "1")], [stop("a", "2")])
    assert desk.a.arrived == [StopNode("1"), StopNode("2")]


def test_calls_about_one_thing_keep_their_order_across_plans(desk: Desk) -> None:
    desk.run([stop("b", "slow"), stop("a", "first", "thing")])
    desk.run([stop("a", "second", "thing")])
    desk.run([stop("a", "other")])
    assert desk.a.arrived == [StopNode("other")]
    desk.answer(desk.b)
    assert desk.a.arrived == [StopNode("other"), StopNode("first")]
    desk.answer(desk.a)
    desk.answer(desk.a)
    assert desk.a.arrived[2:] == [StopNode("second")]


def test_call_that_is_not_needed_any_more_is_not_made(desk: Desk) -> None:
    """Of several connections over a new link the first one opens it."""

    def opening(node: str) -> list[Send | MarkReady]:
        return [replace(stop("a", "open", "link"), unless=thing("link")), ready("link"), stop("a", node), ready(node)]

    first, second = desk.run(opening("1")), desk.run(opening("2"))
    assert desk.a.arrived == [StopNode("open")]
    desk.answer(desk.a)
    assert desk.a.arrived == [StopNode("open"), StopNode("1"), StopNode("2")]
    desk.answer(desk.a)
    desk.answer(desk.a)
    assert results(first) == results(second) == [Nothing(), Nothing()]
    assert desk.is_ready("2")


def test_calls_about_one_thing_at_two_processes_run_concurrently(desk: Desk) -> None:
    desk.run([Send("a", CloseLink("l"), thing("l"))], [Send("b", CloseLink("l"), thing("l"))])
    assert (len(desk.a.arrived), len(desk.b.arrived)) == (1, 1)


def test_calls_wait_for_a_sync_before_them(desk: Desk) -> None:
    """A route reaches an endpoint only after the Sync that makes its interface."""
    desk.run([Send("a", Sync(), None)], [stop("a", "1")])
    desk.run([stop("a", "2"), stop("b", "3")])
    assert (desk.a.arrived, desk.b.arrived) == ([Sync()], [])
    desk.answer(desk.a)
    assert desk.a.arrived == [Sync(), StopNode("1"), StopNode("2")]


def test_next_call_runs_after_a_failure(desk: Desk) -> None:
    failing = desk.run([stop("a", "1", "k"), stop("a", "skipped", "s")])
    desk.run([stop("a", "2", "k")])
    desk.run([stop("a", "3", "s")])
    desk.answer(desk.a, NotFound("no node"))
    assert desk.a.arrived == [StopNode("1"), StopNode("2"), StopNode("3")]
    assert isinstance(results(failing)[-1], NotFound)


# --- errors -----------------------------------------------------------------------------------------------------------


def test_failure_ends_only_its_own_sequence(desk: Desk) -> None:
    task = desk.run([stop("a", "1"), ready("one")], [stop("b", "2"), stop("b", "3"), ready("two")])
    error = StartFailed("exit status 1")
    desk.answer(desk.a, error)
    assert not task.done()
    desk.answer(desk.b)
    desk.answer(desk.b)
    with pytest.raises(StartFailed):
        raise_first_error(task.result())
    assert not desk.is_ready("one")
    assert desk.is_ready("two")
    assert (task.result()[0].send.call, task.result()[0].result) == (StopNode("1"), error)


def test_error_of_the_first_sequence_is_raised(desk: Desk) -> None:
    task = desk.run([stop("a", "1")], [stop("b", "2")])
    desk.answer(desk.b, InvalidRequest("later in the plan"))
    desk.answer(desk.a, NotFound("first in the plan"))
    with pytest.raises(NotFound):
        raise_first_error(task.result())


@pytest.mark.parametrize("lost", [Lost("gone"), Unavailable("link did not open")])
def test_process_that_is_away_misses_its_call_and_others_get_theirs(desk: Desk, lost: RceError) -> None:
    task = desk.run([stop("a", "1"), stop("b", "2"), ready("all")])
    desk.answer(desk.a, lost)
    assert desk.b.arrived == [StopNode("2")]
    desk.answer(desk.b)
    assert results(task) == [Nothing()] * len(task.result())
    assert not desk.is_ready("all")


def test_process_that_never_joined_is_away(desk: Desk) -> None:
    task = desk.run([stop("nobody", "1"), stop("b", "2")])
    desk.answer(desk.b)
    assert results(task) == [Nothing()] * len(task.result())


def test_waiting_call_is_not_sent_over_a_later_connection(desk: Desk) -> None:
    """The process got its Sync, which is newer."""
    desk.run([stop("a", "1", "k")])
    desk.run([stop("a", "2", "k")])
    back = Process()
    desk.runner.dispatcher.controls["a"] = cast(Control, back)
    desk.answer(desk.a, Lost("gone"))
    assert (desk.a.arrived, back.arrived) == ([StopNode("1")], [])


def test_answers_come_with_their_calls(desk: Desk) -> None:
    send = Send("a", Unbind("i"), thing("i"))
    task = desk.run([send])
    desk.answer(desk.a)
    assert task.result() == [Answer(send, Nothing())]


def test_start_of_an_environment_gets_a_new_join_token(desk: Desk) -> None:
    spec = EnvironmentSpec("ann/brain", "1" * 32, "", ContainerData())
    desk.run([Send("a", StartEnvironment(spec), Ref("environment", "ann/brain"))])
    (call,) = desk.a.arrived
    assert isinstance(call, StartEnvironment)
    assert desk.tokens.issued == [("ann/brain", call.environment.token)]
    assert len(call.environment.token) == 64


def test_start_fails_if_its_join_token_cannot_be_stored(desk: Desk) -> None:
    """Or else the start would be taken for one at a machine that is away, and never be made again."""
    desk.tokens.fails = DiskFull.at("the database")
    spec = EnvironmentSpec("ann/brain", "1" * 32, "", ContainerData())
    task = desk.run([Send("a", StartEnvironment(spec), Ref("environment", "ann/brain"))])
    assert desk.a.arrived == []
    (answer,) = task.result()
    assert isinstance(answer.result, StartFailed)
    assert "join token cannot be stored: disk full" in str(answer.result)


def test_start_at_a_machine_that_is_away_keeps_the_token_of_the_earlier_life(desk: Desk) -> None:
    spec = EnvironmentSpec("ann/brain", "1" * 32, "", ContainerData())
    desk.run([Send("nobody", StartEnvironment(spec), Ref("environment", "ann/brain"))])
    assert desk.tokens.issued == []


@pytest.mark.parametrize("made_again", [False, True])
def test_removed_environment_loses_its_tokens(desk: Desk, made_again: bool) -> None:
    environments = desk.runner.state.environments

    def remove() -> None:
        environment = Environment("ann/brain", EnvironmentOptions(), "1", "")
        environments.put(environment)
        environments.drop("ann/brain")
        desk.runner.save()
        if made_again:
            environments.put(environment)

    desk.hand.do(remove)
    assert desk.tokens.issued == ([] if made_again else [("forget", "ann/brain")])


def test_close_cancels_running_plans(desk: Desk, hand: HandTurnedLoop) -> None:
    task = desk.run([stop("a", "1"), ready("x")])
    closing = hand.begin(desk.runner.close())
    assert closing.done()
    assert task.cancelled()
    assert not desk.is_ready("x")


def test_settled_waits_for_earlier_calls_about_the_same_thing(desk: Desk) -> None:
    desk.run([stop("a", "1", "robot")], [stop("a", "2", "other")])
    waiting = desk.hand.begin(desk.runner.dispatcher.settled("a", thing("robot")))
    assert not waiting.done()
    desk.answer(desk.a)
    assert waiting.done()
    assert desk.hand.begin(desk.runner.dispatcher.settled("b", thing("robot"))).done()
