"""Process tracker: machines and Robot endpoints that leave and return, with a clock turned by hand."""

from __future__ import annotations

import asyncio

import pytest
from msgspec.structs import replace

from master.execution import lifecycle
from master.execution.effect_runner import new_id
from master.execution.lifecycle import RETRY_FIRST
from master.execution.process_tracker import CUT_OFF
from master.graph import reconcile, sessions
from master.graph.effects import Plan
from master.graph.records import Robot
from master.graph.state import State
from master.graph.wiring import Ids
from rce.api.roles import Principal
from rce.control.calls.endpoints import AddRoute, RemoveRoute, Sync
from rce.control.calls.environments import KeepEnvironments, StartEnvironment
from rce.control.calls.joining import Hello
from rce.control.calls.robots import SendStatus
from rce.errors import AlreadyExists, NoCapacity, StartFailed
from rce.protocol import messages as m
from rce.protocol.messages import EnvironmentEvent
from tests.support.master.desk import GRACE, ROBOT_GRACE, Desk, Peer
from tests.support.master.fleet import interface


def events(peer: Peer) -> list[tuple[str, str]]:
    said = [tell.status for tell in peer.got(SendStatus) if isinstance(tell.status, EnvironmentEvent)]
    return [(status.containerTag, status.state) for status in said]


def test_many_environments_of_lost_machines_move_in_turns(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each turn is short, and there is one series of them however many machines are lost at once."""
    monkeypatch.setattr(lifecycle, "RESETTLED_AT_ONCE", 1)
    lost = [desk.machine(name) for name in ("m1", "m2")]
    names = [f"brain{number}" for number in range(2)]
    for name in names:
        desk.made(name).leave()
    other = desk.machine("m3")
    turns: list[int] = []
    resettle = reconcile.resettle

    def counted(state: State, ids: Ids, most: float) -> Plan:
        plan = resettle(state, ids, most)
        turns.append(len(plan))
        return plan

    monkeypatch.setattr(reconcile, "resettle", counted)
    for machine in lost:
        machine.leave()
    desk.turn(GRACE)
    desk.turn(RETRY_FIRST)
    assert turns == [1, 1, 0]
    assert sorted(call.environment.name for call in other.got(StartEnvironment)) == [f"ann/{name}" for name in names]


def test_environments_of_a_lost_machine_move_with_their_contents(desk: Desk) -> None:
    west, m1 = desk.robot(), desk.machine("m1")
    brain = desk.made("brain")
    desk.do(
        m.AddNode("brain", "n", "p", "e"),
        m.SetParameter("brain", "p", 7),
        interface("r1", "pose", "SubscriberConverter"),
        interface("brain", "pose", "PublisherInterface"),
        m.Connect("r1/pose", "brain/pose"),
    )
    before = desk.run("brain")
    m2 = desk.machine("m2")
    brain.leave()
    desk.turn(5)
    m1.leave()
    desk.turn(GRACE - 1)
    assert (desk.at("brain"), events(west)) == ("m1", [("brain", "ready")])
    desk.turn(1)
    assert events(west)[1:] == [("brain", "lost")]
    desk.turn(RETRY_FIRST)
    (start,) = m2.got(StartEnvironment)
    assert (start.environment.name, start.environment.run != before) == ("ann/brain", True)
    again = desk.endpoint("brain")
    (sync,) = again.got(Sync)
    assert [each.tag for each in sync.nodes] == ["n"]
    assert [each.value for each in sync.parameters] == [7]
    assert [each.tag for each in sync.interfaces] == ["pose"]
    assert len(again.got(AddRoute)) == 1
    assert events(west)[2:] == [("brain", "ready")]
    back = desk.machine("m1", brain=before)
    assert back.got(KeepEnvironments) == [KeepEnvironments([])]
    assert desk.at("brain") == "m2"


def test_removed_machine_loses_its_environments_at_once(desk: Desk) -> None:
    west, m1 = desk.robot(), desk.machine("m1")
    brain = desk.made("brain")
    m2 = desk.machine("m2")
    desk.hand.do(lambda: asyncio.ensure_future(desk.master.process_tracker.evict("m1")))
    assert m1.lost.done()
    assert brain.lost.done()
    assert events(west)[1:] == [("brain", "lost")]
    desk.turn(RETRY_FIRST)
    (start,) = m2.got(StartEnvironment)
    assert start.environment.name == "ann/brain"
    assert desk.at("brain") == "m2"


def test_removed_robot_endpoint_loses_its_robots_at_once(desk: Desk) -> None:
    west = desk.robot()
    desk.hand.do(lambda: asyncio.ensure_future(desk.master.process_tracker.evict("west")))
    assert west.lost.done()
    assert "ann/r1" not in desk.state.robots


def test_environment_lives_while_its_endpoint_is_connected(desk: Desk) -> None:
    """The task set is gone first; the endpoint then has a grace period of its own."""
    west, m1 = desk.robot(), desk.machine("m1")
    brain = desk.made("brain")
    desk.machine("m2")
    run = desk.run("brain")
    m1.leave()
    desk.turn(10 * GRACE)
    assert (desk.run("brain"), events(west)) == (run, [("brain", "ready")])
    brain.leave()
    desk.turn(GRACE - 1)
    assert desk.run("brain") == run
    desk.turn(1 + RETRY_FIRST)
    assert (desk.at("brain"), events(west)[1:]) == ("m2", [("brain", "lost")])


def test_machine_that_returns_in_time_loses_nothing(desk: Desk) -> None:
    west, m1 = desk.robot(), desk.machine("m1")
    brain = desk.made("brain")
    m2 = desk.machine("m2")
    run = desk.run("brain")
    for _ in range(3):
        brain.leave()
        m1.leave()
        desk.turn(GRACE - 1)
        m1, brain = desk.machine("m1", brain=run), desk.endpoint("brain")
        assert m1.got(KeepEnvironments) == [KeepEnvironments([run])]
    desk.turn(10 * GRACE)
    assert (desk.run("brain"), m2.got(StartEnvironment), m1.got(StartEnvironment)) == (run, [], [])
    assert "lost" not in [state for _, state in events(west)]


def test_environment_with_restart_no_is_removed_with_its_machine(desk: Desk) -> None:
    west, m1 = desk.robot(), desk.machine("m1")
    once, m2 = desk.made("once", restart="no"), desk.machine("m2")
    run = desk.run("once")
    once.leave()
    m1.leave()
    desk.turn(GRACE + RETRY_FIRST)
    assert events(west)[1:] == [("once", "gone")]
    assert ("ann/once" in desk.state.environments, m2.got(StartEnvironment)) == (False, [])
    assert desk.machine("m1", once=run).got(KeepEnvironments) == [KeepEnvironments([])]


def test_environment_without_another_machine_waits_and_may_survive(desk: Desk) -> None:
    west, m1 = desk.robot(), desk.machine("m1")
    brain = desk.made("brain")
    run = desk.run("brain")
    brain.leave()
    m1.leave()
    desk.turn(10 * GRACE)
    assert events(west)[1:] == [("brain", "lost")]
    m1 = desk.machine("m1", brain=run)
    desk.endpoint("brain")
    assert (m1.got(KeepEnvironments), m1.got(StartEnvironment)) == ([KeepEnvironments([run])], [])
    assert events(west)[2:] == [("brain", "ready")]


def test_waiting_environment_moves_when_there_is_room(desk: Desk) -> None:
    m1, m2 = desk.machine("m1"), desk.machine("m2")
    brain = desk.made("brain", size=2)
    m1, m2 = (m1, m2) if desk.at("brain") == "m1" else (m2, m1)
    other = desk.made("other", size=2)
    brain.leave()
    m1.leave()
    desk.turn(GRACE + RETRY_FIRST)
    assert [call.environment.name for call in m2.got(StartEnvironment)] == ["ann/other"]
    other.leave()
    desk.do(m.DestroyContainer("other"))
    assert [call.environment.name for call in m2.got(StartEnvironment)] == ["ann/other", "ann/brain"]


def test_first_start_on_a_lost_machine_fails_with_the_reason(desk: Desk) -> None:
    m1 = desk.machine("m1")
    task = desk.do(m.CreateContainer("brain"))
    m1.leave()
    desk.turn(GRACE)
    assert isinstance(task.exception(), StartFailed)
    assert "m1 has been away for 30 s" in str(task.exception())
    assert "ann/brain" not in desk.state.environments


def test_environment_requested_during_a_task_set_restart_is_started_after_it(desk: Desk) -> None:
    desk.machine("m1").leave()
    task = desk.do(m.CreateContainer("brain"), m.AddNode("brain", "n", "p", "e"))
    desk.turn(GRACE - 1)
    assert not task.done()
    m1 = desk.machine("m1")
    assert [call.environment.name for call in m1.got(StartEnvironment)] == ["ann/brain"]
    assert [each.tag for each in desk.endpoint("brain").got(Sync)[0].nodes] == ["n"]
    assert task.result() is None


def test_environment_is_refused_if_no_task_set_returns(desk: Desk) -> None:
    m1 = desk.machine("m1")
    task = desk.do(m.CreateContainer("big", m.ContainerData(size=3)))
    assert isinstance(task.exception(), NoCapacity)
    m1.leave()
    task = desk.do(m.CreateContainer("brain"))
    desk.turn(GRACE)
    assert isinstance(task.exception(), NoCapacity)
    assert isinstance(desk.do(m.CreateContainer("brain")).exception(), NoCapacity)
    assert len(desk.state.environments) == 0


# --- Robot endpoints --------------------------------------------------------------------------------------------------


def test_robots_of_a_lost_endpoint_are_removed_after_the_grace_period(desk: Desk) -> None:
    west, brain = desk.wired()
    west.leave()
    desk.turn(ROBOT_GRACE - 1)
    assert ("ann/r1" in desk.state.robots, brain.got(RemoveRoute)) == (True, [])
    desk.turn(1)
    assert "ann/r1" not in desk.state.robots
    assert "west" not in desk.state.processes
    assert len(brain.got(RemoveRoute)) == 1


def test_robots_of_an_endpoint_that_returns_in_time_stay(desk: Desk) -> None:
    west, brain = desk.wired()
    west.leave()
    desk.turn(ROBOT_GRACE - 1)
    (sync,) = Peer(desk, Hello("robot", "west", "", "", "1", robots=["ann/r1"])).got(Sync)
    assert (sync.robots, len(sync.routes)) == (["ann/r1"], 1)
    desk.turn(10 * ROBOT_GRACE)
    assert "ann/r1" in desk.state.robots
    assert brain.got(RemoveRoute) == []


def test_robots_of_an_endpoint_behind_a_cut_line_stay_beyond_the_grace_period(desk: Desk) -> None:
    west, brain = desk.wired()
    west.leave(silently=True)
    desk.turn(ROBOT_GRACE)
    assert desk.state.gone("west")
    desk.turn(CUT_OFF - 1)
    assert ("ann/r1" in desk.state.robots, brain.got(RemoveRoute)) == (True, [])
    (sync,) = Peer(desk, Hello("robot", "west", "", "", "1", robots=["ann/r1"])).got(Sync)
    assert (sync.robots, len(sync.routes)) == (["ann/r1"], 1)
    desk.turn(2 * CUT_OFF)
    assert "ann/r1" in desk.state.robots
    assert brain.got(RemoveRoute) == []


def test_robots_of_a_silent_endpoint_that_does_not_come_back_are_removed_in_the_end(desk: Desk) -> None:
    west, brain = desk.wired()
    west.leave(silently=True)
    desk.turn(ROBOT_GRACE + CUT_OFF)
    assert "ann/r1" not in desk.state.robots
    assert "west" not in desk.state.processes
    assert len(brain.got(RemoveRoute)) == 1


def test_robot_of_an_endpoint_behind_a_cut_line_may_begin_anew_elsewhere(desk: Desk) -> None:
    west, _ = desk.wired()
    Peer(desk, Hello("robot", "east", "", "", "1"))
    anew = Robot("ann/r1", "east", "t", Principal("ann", "user"))
    desk.state.robots.put(replace(desk.state.robots["ann/r1"], principal=Principal("ann", "user")))
    west.leave(silently=True)
    desk.turn(ROBOT_GRACE - 1)
    with pytest.raises(AlreadyExists):
        desk.hand.do(lambda: sessions.robot_arrived(desk.state, anew, "", new_id))
    desk.turn(1)
    _, resumed = desk.hand.do(lambda: sessions.robot_arrived(desk.state, anew, "", new_id))
    assert not resumed
    (sync,) = Peer(desk, Hello("robot", "west", "", "", "1", robots=["ann/r1"])).got(Sync)
    assert sync.robots == [], "so the endpoint ends the session that it has"
    assert desk.state.robots["ann/r1"].endpoint == "east"


def test_robot_that_its_endpoint_lacks_may_resume_elsewhere_within_the_grace_period(desk: Desk) -> None:
    desk.wired()
    desk.state.robots.put(Robot("ann/r2", "west", "s"))
    Peer(desk, Hello("robot", "west", "", "", "2"))
    desk.turn(ROBOT_GRACE - 1)
    desk.state.robots.put(Robot("ann/r1", "east", "t"))  # as a login at another endpoint does
    desk.turn(1)
    assert [robot.name for robot in desk.state.robots] == ["ann/r1"]


def test_second_connection_of_a_process_replaces_the_first(desk: Desk) -> None:
    west, _ = desk.wired()
    Peer(desk, Hello("robot", "west", "", "", "1", robots=["ann/r1"]))
    assert west.lost.done()
    desk.turn(10 * ROBOT_GRACE)
    assert "west" in desk.state.joined
    assert "ann/r1" in desk.state.robots
