"""Goals at the interface that carries them out, without ROS and without robots."""

from __future__ import annotations

import pytest

from endpoints.data import goals as module
from endpoints.data.frames import Message, Phase
from endpoints.data.goals import Goals
from endpoints.data.hops import HopRecorder
from endpoints.data.interface import Interface, error_of
from endpoints.data.link import Link, LoopLink
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import Forbidden, Lost

ID, OTHER = "1a" * 16, "2b" * 16
ANN, BOB = b"a" * 16, b"b" * 16


class Executor(Interface):
    """Interface that notes what it is to carry out; `answers` are those to each peer."""

    def __init__(self) -> None:
        super().__init__(InterfaceSpec("11" * 16, "user/robot", "act", "ActionClientConverter", "a/B"), HopRecorder())
        self.started: list[str] = []
        self.canceled: list[str] = []
        self.goals = Goals(self, lambda message: self.started.append(message.msg_id), self.canceled.append)
        self.answers: dict[bytes, list[Message]] = {ANN: [], BOB: []}
        for peer, answers in self.answers.items():
            self.peers[peer] = LoopLink("loop", lambda message, _, to=answers: to.append(message), lambda _: None)

    def receive(self, message: Message, link: Link) -> None:
        self.goals.receive(message)

    def ask(self, phase: Phase, id: str = ID, peer: bytes = ANN) -> None:
        self.goals.receive(Message(peer, id, b"", phase=phase))

    def phases(self, peer: bytes = ANN) -> list[Phase]:
        return [each.phase for each in self.answers[peer] if not each.error]

    def errors(self, peer: bytes = ANN) -> list[tuple[str, Phase]]:
        return [(error_of(each).info.code, each.phase) for each in self.answers[peer] if each.error]


@pytest.fixture
async def executor() -> Executor:
    return Executor()


async def test_asker_alone_gets_what_becomes_of_its_goal(executor: Executor) -> None:
    executor.ask(Phase.GOAL)
    for phase in (Phase.ACCEPTED, Phase.FEEDBACK, Phase.SUCCEEDED):
        executor.goals.answer(ID, phase)
    executor.goals.answer(ID, Phase.FEEDBACK)
    assert executor.started == [ID]
    assert executor.phases() == [Phase.ACCEPTED, Phase.FEEDBACK, Phase.SUCCEEDED], "nothing comes after the end"
    assert executor.answers[BOB] == []


async def test_goal_that_is_not_accepted_yet_is_canceled_when_it_is(executor: Executor) -> None:
    executor.ask(Phase.GOAL)
    executor.ask(Phase.CANCEL)
    assert executor.canceled == []
    executor.goals.answer(ID, Phase.ACCEPTED)
    assert executor.canceled == [ID]


async def test_goal_that_has_ended_cannot_be_canceled(executor: Executor) -> None:
    executor.ask(Phase.GOAL)
    executor.goals.answer(ID, Phase.REJECTED)
    executor.ask(Phase.CANCEL)
    assert executor.errors() == [("not_found", Phase.CANCEL)]


async def test_refused_cancellation_does_not_end_the_goal(executor: Executor) -> None:
    executor.ask(Phase.GOAL)
    executor.goals.not_canceled(ID, Forbidden("no"))
    executor.goals.answer(ID, Phase.SUCCEEDED)
    assert executor.errors() == [("forbidden", Phase.CANCEL)]
    assert executor.phases() == [Phase.SUCCEEDED]


@pytest.mark.parametrize(("phase", "canceled"), [(Phase.GOAL, []), (Phase.LEASED_GOAL, [ID])])
async def test_only_leased_goals_are_canceled_with_their_asker(
    executor: Executor, phase: Phase, canceled: list[str]
) -> None:
    executor.ask(phase)
    executor.goals.answer(ID, Phase.ACCEPTED)
    executor.goals.left(BOB)
    assert executor.canceled == []
    executor.goals.left(ANN)
    assert executor.canceled == canceled


async def test_asker_that_comes_back_gets_the_result(executor: Executor) -> None:
    executor.ask(Phase.GOAL)
    executor.goals.answer(ID, Phase.ACCEPTED)
    del executor.peers[ANN]
    executor.ask(Phase.RESULT, peer=BOB)
    assert executor.phases(BOB) == [Phase.ACCEPTED]
    executor.goals.answer(ID, Phase.CANCELED, b"result")
    executor.ask(Phase.RESULT, peer=BOB)
    assert executor.phases(BOB) == [Phase.ACCEPTED, Phase.CANCELED, Phase.CANCELED]
    assert executor.answers[BOB][-1].payload == b"result"


async def test_result_that_came_while_the_asker_was_away_is_kept(executor: Executor) -> None:
    executor.ask(Phase.GOAL)
    del executor.peers[ANN]
    executor.goals.fail(ID, Lost("gone"))
    executor.ask(Phase.RESULT, peer=BOB)
    assert executor.errors(BOB) == [("lost", Phase.NONE)]


async def test_unknown_goal_has_no_result(executor: Executor) -> None:
    executor.ask(Phase.RESULT)
    assert executor.errors() == [("not_found", Phase.NONE)]


@pytest.mark.parametrize("id", ["", "1A" * 16, "1a" * 17, "1a" * 15 + "\n"])
async def test_id_that_is_no_uuid_is_refused(executor: Executor, id: str) -> None:
    executor.ask(Phase.GOAL, id)
    assert executor.errors() == [("invalid_request", Phase.NONE)]


async def test_id_is_used_once(executor: Executor) -> None:
    executor.ask(Phase.GOAL)
    executor.goals.answer(ID, Phase.SUCCEEDED)
    executor.ask(Phase.GOAL, peer=BOB)
    assert executor.errors(BOB) == [("already_exists", Phase.NONE)]


async def test_unfinished_goals_and_kept_results_are_limited(
    executor: Executor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MAX_GOALS", 1)
    monkeypatch.setattr(module, "MAX_KEPT", 1)
    executor.ask(Phase.GOAL)
    executor.ask(Phase.GOAL, OTHER)
    assert executor.errors() == [("limit_exceeded", Phase.NONE)]
    executor.goals.answer(ID, Phase.SUCCEEDED)
    executor.ask(Phase.GOAL, OTHER)
    executor.goals.answer(OTHER, Phase.SUCCEEDED)
    executor.ask(Phase.RESULT, peer=BOB)
    executor.ask(Phase.RESULT, OTHER, BOB)
    assert executor.errors(BOB) == [("not_found", Phase.NONE)], "the older result is not kept"
    assert executor.phases(BOB) == [Phase.SUCCEEDED]


async def test_kept_results_are_limited_by_bytes_and_freed_at_the_end(executor: Executor) -> None:
    for number in range(8):
        id = f"{number:032x}"
        executor.ask(Phase.GOAL, id)
        executor.goals.answer(id, Phase.SUCCEEDED, bytes(module.MAX_KEPT_BYTES // 4))
    assert module.MAX_KEPT_BYTES // 2 < executor.budget.used <= module.MAX_KEPT_BYTES
    executor.goals.close()
    assert executor.budget.used == 0


async def test_feedback_that_a_slow_link_cannot_take_is_dropped_and_counted(
    executor: Executor, monkeypatch: pytest.MonkeyPatch
) -> None:
    executor.ask(Phase.GOAL)
    monkeypatch.setattr(executor.peers[ANN], "backlog", lambda source: module.MAX_FEEDBACK)
    executor.goals.answer(ID, Phase.FEEDBACK)
    executor.goals.answer(ID, Phase.SUCCEEDED)
    assert (executor.dropped, executor.phases()) == (1, [Phase.SUCCEEDED])
