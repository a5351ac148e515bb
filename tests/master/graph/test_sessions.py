"""Sessions of robots that arrive, resume and leave."""

from __future__ import annotations

import pytest

from master.graph import reconcile, sessions
from rce.control.calls.endpoints import AddRoute, Bind, CloseLink, OpenLink, RemoveRoute, Unbind
from rce.control.calls.robots import DropRobot
from rce.errors import AlreadyExists, InvalidName
from rce.protocol import messages as m
from tests.support.master.fleet import calls, everything, furnished, interface, wired


def test_lost_endpoint_strands_its_robots() -> None:
    fleet = wired()
    reconcile.left(fleet.state, "west")
    plan, stranded = sessions.endpoint_gone(fleet.state, "west")
    assert stranded == ["ann/r1", "bob/r1"]
    assert [type(call) for call in calls(plan, "ann/brain")] == [RemoveRoute, CloseLink]
    assert "ann/r1/pose" in fleet.state.interfaces
    sessions.robot_left(fleet.state, "ann/r1")
    assert "ann/r1/pose" not in fleet.state.interfaces
    assert sessions.robot_left(fleet.state, "ann/r1") == []


def test_interfaces_that_a_robot_added_for_its_own_go_with_it() -> None:
    fleet = furnished()
    for command in (
        interface("r1", "pose", "SubscriberConverter"),
        interface("brain", "pose", "PublisherInterface"),
        interface("brain", "unconnected", "PublisherInterface"),
        m.Connect("r1/pose", "brain/pose"),
    ):
        fleet.do("ann", command, robot="r1")
    plan = sessions.robot_left(fleet.state, "ann/r1")
    assert [each.tag for each in fleet.state.interfaces.by("ann/brain")] == ["unconnected"]
    assert any(isinstance(call, Unbind) for call in calls(plan, "ann/brain"))


@pytest.mark.parametrize("adder", ["", "r2"])
def test_interfaces_that_others_added_or_use_stay(adder: str) -> None:
    fleet = furnished()
    fleet.robot("ann/r2")
    fleet.do("ann", interface("brain", "pose", "PublisherInterface"), robot=adder)
    fleet.do("ann", interface("brain", "shared", "PublisherInterface"), robot="r1")
    for robot in ("r1", "r2"):
        fleet.do("ann", interface(robot, "pose", "SubscriberConverter"), robot=robot)
        fleet.do("ann", m.Connect(f"{robot}/pose", "brain/shared"), robot=robot)
    fleet.do("ann", m.Connect("r1/pose", "brain/pose"), robot="r1")
    sessions.robot_left(fleet.state, "ann/r1")
    assert [each.tag for each in fleet.state.interfaces.by("ann/brain")] == ["pose", "shared"]


def test_interface_stays_while_a_connection_that_another_asked_for_waits() -> None:
    fleet = furnished()
    fleet.do("ann", interface("r1", "pose", "SubscriberConverter"), robot="r1")
    fleet.do("ann", interface("brain", "pose", "PublisherInterface"), robot="r1")
    fleet.do("ann", m.Connect("r1/pose", "brain/pose"))
    sessions.robot_left(fleet.state, "ann/r1")
    assert [each.tag for each in fleet.state.interfaces.by("ann/brain")] == ["pose"]


@pytest.mark.parametrize(
    ("name", "resume", "error"),
    [
        ("ann/r1", "", AlreadyExists),
        ("ann/r1", "x", AlreadyExists),
        ("ann/brain", "", AlreadyExists),
        ("ann/1", "", InvalidName),
    ],
)
def test_robot_in_use_is_refused(name: str, resume: str, error: type[Exception]) -> None:
    fleet = wired()
    before = everything(fleet.state)
    with pytest.raises(error):
        fleet.robot(name, resume=resume)
    assert everything(fleet.state) == before


def test_robot_resumes_at_its_endpoint() -> None:
    fleet = wired()
    outcome, resumed = fleet.robot("ann/r1", session="t", resume="s")
    assert (outcome.plan, resumed) == ([], True)


def test_token_is_valid_until_the_next_one_is_used() -> None:
    """The answer with the next one may be lost."""
    fleet = wired()
    for session, resume in (("t", "s"), ("u", "s"), ("v", "u")):
        assert fleet.robot("ann/r1", session=session, resume=resume)[1]
    for used in ("s", "t"):
        with pytest.raises(AlreadyExists):
            fleet.robot("ann/r1", session="w", resume=used)
    assert fleet.robot("ann/r1", session="w", resume="v")[1]


def test_robot_takes_the_place_of_an_earlier_one_that_lost_its_socket() -> None:
    fleet = wired()
    sessions.socket_moved(fleet.state, "ann/r1", False)
    outcome, resumed = fleet.robot("ann/r1", session="t")
    assert not resumed
    assert DropRobot in map(type, calls(outcome.plan, "west"))
    assert not fleet.state.interfaces.by("ann/r1")
    assert fleet.state.robots["ann/r1"].session == "t"
    with pytest.raises(AlreadyExists):
        fleet.robot("ann/r1", session="u", resume="s")


def test_guest_does_not_take_the_place_of_another_users() -> None:
    fleet = wired()
    fleet.robot("ann/@guest", by="bob")
    sessions.socket_moved(fleet.state, "ann/@guest", False)
    with pytest.raises(AlreadyExists):
        fleet.robot("ann/@guest", by="eve")


def test_robot_that_is_away_is_removed_or_resumes() -> None:
    fleet = wired()
    sessions.socket_moved(fleet.state, "ann/r1", False)
    sessions.socket_moved(fleet.state, "bob/r1", False)
    fleet.robot("ann/r1", session="t", resume="s")
    assert fleet.state.away == {"bob/r1"}
    sessions.robot_left(fleet.state, "bob/r1")
    assert fleet.state.away == set()


def test_robot_resumes_at_another_endpoint_with_its_interfaces() -> None:
    fleet = wired()
    fleet.join("east", "robot")
    outcome, resumed = fleet.robot("ann/r1", "east", "t", "s")
    assert resumed
    assert [type(call) for call in calls(outcome.plan, "east")] == [Bind, OpenLink, AddRoute]
    assert DropRobot("ann/r1", "resumed elsewhere") in calls(outcome.plan, "west")
    (link,) = fleet.state.links
    assert "east" in (link.listener, link.dialler)
