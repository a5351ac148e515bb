"""Nodes that end by themselves are started again or kept with their end."""

from __future__ import annotations

from typing import Any

import pytest

from rce.control.calls.endpoints import NodeDied, StartNode
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


def test_reason_of_a_failed_restart_is_kept(desk: Desk) -> None:
    _, brain = desk.wired()
    desk.do(m.AddNode("brain", "n", "p", "e", restart="always"))
    brain.refuse[StartNode] = StartFailed("its file is gone")
    die(desk, 1)
    desk.turn(5.0)
    assert "ann/brain/n" not in desk.state.nodes
    assert desk.state.ends["ann/brain/n"].lines == ["last words", "not started again: its file is gone"]
