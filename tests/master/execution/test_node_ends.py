"""Nodes that end by themselves are started again or kept with their end."""

from __future__ import annotations

from typing import Any

import pytest

from rce.control.calls.endpoints import Launched, NodeDied, NodeSpec, StartNode, StopNode
from rce.errors import StartFailed
from rce.protocol import messages as m
from tests.support.master.desk import Desk


def die(desk: Desk, status: int, seconds: float = 1.0, lines: tuple[str, ...] = ("last words",)) -> None:
    process = desk.state.processes["ann/brain"]
    call = NodeDied("n", status, list(lines), seconds=seconds)
    desk.hand.begin(desk.master._lifecycle._node_ends.node_died(process, call))


@pytest.mark.parametrize(
    ("restart", "status", "seconds", "again"),
    [
        ("", 1, 60.0, True),
        ("", 1, 1.0, False),
        ("", 0, 60.0, False),
        ("on-failure", 1, 0.1, True),
        ("on-failure", -9, 0.1, True),
        ("on-failure", 0, 60.0, False),
        ("always", 0, 0.1, True),
        ("no", 1, 60.0, False),
    ],
)
def test_node_is_started_again_as_it_says(desk: Desk, restart: Any, status: int, seconds: float, again: bool) -> None:
    _, brain = desk.wired()
    desk.do(m.AddNode("brain", "n", "p", "e", restart=restart))
    die(desk, status, seconds)
    desk.turn(1.0)
    assert len(brain.got(StartNode)) == 1 + again
    assert ("ann/brain/n" in desk.state.nodes) == again


def test_pauses_between_restarts_grow(desk: Desk) -> None:
    _, brain = desk.wired()
    desk.do(m.AddNode("brain", "n", "p", "e", restart="always"))
    for pause in (0.1, 0.5, 1.0, 2.0):
        starts = len(brain.got(StartNode))
        die(desk, 1)
        desk.turn(0.9 * pause)
        assert len(brain.got(StartNode)) == starts
        desk.turn(0.2 * pause)
        assert len(brain.got(StartNode)) == starts + 1


def test_last_end_is_kept_until_a_user_starts_the_node_anew(desk: Desk) -> None:
    desk.wired()
    desk.do(m.AddNode("brain", "n", "p", "e"))
    die(desk, -11, lines=("a", "b"))
    end = desk.state.ends["ann/brain/n"]
    assert (end.status, end.lines, end.count) == (-11, ["a", "b"], 1)
    view = desk.master.presenter.ended_node(end)
    assert (view.state, view.end and view.end.signal) == ("ended", "SIGSEGV")
    desk.do(m.AddNode("brain", "n", "p", "e"))
    assert "ann/brain/n" not in desk.state.ends


def test_ends_are_counted_and_removed_with_the_environment(desk: Desk) -> None:
    desk.wired()
    desk.do(m.AddNode("brain", "n", "p", "e", restart="always"))
    for _ in range(2):
        die(desk, 0)
        assert desk.master.presenter.node(desk.state.nodes["ann/brain/n"]).state == "waiting"
        desk.turn(5.0)
    assert desk.state.ends["ann/brain/n"].count == 2
    desk.do(m.DestroyContainer("brain"))
    assert not [*desk.state.ends]


def test_node_that_was_removed_meanwhile_is_not_started_again(desk: Desk) -> None:
    _, brain = desk.wired()
    desk.do(m.AddNode("brain", "n", "p", "e", restart="always"))
    die(desk, 1)
    desk.do(m.RemoveNode("brain", "n"))
    desk.turn(5.0)
    assert len(brain.got(StartNode)) == 1


def test_node_that_took_the_place_of_one_that_waits_is_started_again_as_well(desk: Desk) -> None:
    _, brain = desk.wired()
    desk.do(m.AddNode("brain", "n", "p", "e", restart="always"))
    for _ in range(3):
        die(desk, 1)  # its pauses grow
        desk.turn(5.0)
    die(desk, 1)
    desk.do(m.AddNode("brain", "n", "p", "e", "--fixed", restart="always", existOk=True))
    starts = len(brain.got(StartNode))
    die(desk, 2)
    assert desk.state.ends["ann/brain/n"].status == 2
    desk.turn(60.0)
    assert [call.node.args for call in brain.got(StartNode)[starts:]] == ["--fixed"]


def test_reason_of_a_failed_restart_is_kept(desk: Desk) -> None:
    _, brain = desk.wired()
    desk.do(m.AddNode("brain", "n", "p", "e", restart="always"))
    brain.refuse[StartNode] = StartFailed("its file is gone")
    die(desk, 1)
    desk.turn(5.0)
    assert "ann/brain/n" not in desk.state.nodes
    assert desk.state.ends["ann/brain/n"].lines == ["last words", "not started again: its file is gone"]


LAUNCH = m.AddNode("brain", "up", "p", launch="up.launch.py", args="rate:=5")


def launched(desk: Desk, *tags: str) -> None:
    """Report the nodes that run of the launch `up`."""
    process = desk.state.processes["ann/brain"]
    call = Launched("up", [NodeSpec(f"up.{tag}", "p", "e", "-x", tag) for tag in tags])
    desk.hand.begin(desk.master._lifecycle._node_ends.launched(process, call))
    desk.turn(0.0)


def ended(desk: Desk, tag: str, again: bool = False) -> None:
    process = desk.state.processes["ann/brain"]
    call = NodeDied(tag, 3, ["last words"], 60.0, again)
    desk.hand.begin(desk.master._lifecycle._node_ends.node_died(process, call))
    desk.turn(0.0)


def views(desk: Desk) -> dict[str, str]:
    """Return the states of the nodes by tag."""
    return {each.tag: desk.master.presenter.node(each).state for each in desk.state.nodes.by("ann/brain")}


def test_nodes_of_launch_are_shown_one_by_one(desk: Desk) -> None:
    _, brain = desk.wired()
    desk.do(LAUNCH)
    assert brain.got(StartNode)[-1].node == NodeSpec("up", "p", "", "rate:=5", launch="up.launch.py")
    launched(desk, "a", "b")
    assert views(desk) == {"up": "running", "up.a": "running", "up.b": "running"}
    view = desk.master.presenter.node(desk.state.nodes["ann/brain/up.a"])
    assert (view.pkg, view.exe, view.args, view.partOf) == ("p", "e", "-x", "up")
    launched(desk, "b")
    assert views(desk) == {"up": "running", "up.b": "running"}


def test_node_of_launch_that_ends_leaves_its_end_alone(desk: Desk) -> None:
    _, brain = desk.wired()
    desk.do(LAUNCH)
    launched(desk, "a", "b")
    ended(desk, "up.a")
    ended(desk, "up.b", again=True)
    assert views(desk) == {"up": "running", "up.b": "waiting"}
    assert desk.state.ends["ann/brain/up.a"].lines == ["last words"]
    launched(desk, "b")
    assert views(desk) == {"up": "running", "up.b": "running"}
    assert len(brain.got(StartNode)) == 1


def test_launch_ends_with_all_of_its_nodes(desk: Desk) -> None:
    _, brain = desk.wired()
    desk.do(LAUNCH)
    launched(desk, "a", "b")
    desk.do(m.RemoveNode("brain", "up"))
    assert views(desk) == {}
    assert [call.node for call in brain.got(StopNode)] == ["up"]
    launched(desk, "a")  # late
    assert views(desk) == {}


def test_launch_that_failed_is_started_again_without_its_old_nodes(desk: Desk) -> None:
    _, brain = desk.wired()
    desk.do(LAUNCH)
    launched(desk, "a")
    ended(desk, "up")
    assert views(desk) == {"up": "waiting"}
    desk.turn(5.0)
    assert views(desk) == {"up": "running"}
    assert len(brain.got(StartNode)) == 2
