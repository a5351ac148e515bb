"""Reconciliation of processes and robots that join, leave and return."""

from __future__ import annotations

from typing import Any

import pytest

from master.graph import reconcile
from master.graph.records import Role
from rce.control.calls.endpoints import AddRoute, Bind, CloseLink, OpenLink, RemoveRoute, Sync, Unbind
from rce.control.calls.environments import KeepEnvironments, SetRelays, StartEnvironment
from rce.control.calls.robots import DropRobot
from rce.errors import AlreadyExists, InvalidName
from rce.protocol import messages as m
from tests.support.master.fleet import Fleet, calls, everything, furnished, interface, wired


def sync_of(fleet: Fleet, to: str, role: Role = "robot", incarnation: str = "1", **hello: Any) -> Sync:
    plan = fleet.join(to, role, incarnation, **hello)
    (sync,) = [call for call in calls(plan, to) if isinstance(call, Sync)]
    return sync


# --- endpoints --------------------------------------------------------------------------------------------------------


def test_reconnected_process_keeps_its_links() -> None:
    fleet = wired()
    before = everything(fleet.state)
    reconcile.left(fleet.state, "ann/brain")
    plan = fleet.join("ann/brain", "environment", host="h2")
    (sync,) = calls(plan)
    assert isinstance(sync, Sync)
    assert (len(sync.interfaces), len(sync.links), len(sync.routes)) == (1, 1, 1)
    assert everything(fleet.state) == before


def test_restarted_process_gets_new_links() -> None:
    fleet = wired()
    (old,) = fleet.state.links
    reconcile.left(fleet.state, "ann/brain")
    plan = fleet.join("ann/brain", "environment", "2")
    (new,) = fleet.state.links
    assert (new.name != old.name, new.incarnations) == (True, ("1", "2"))
    assert {type(call) for call in calls(plan, "west")} == {RemoveRoute, CloseLink, OpenLink, AddRoute}


def test_restarted_robot_endpoint_with_robots_gets_new_links() -> None:
    fleet = wired()
    (old,) = fleet.state.links
    reconcile.left(fleet.state, "west")
    fleet.join("west", "robot", "2", robots=["ann/r1", "bob/r1"])
    (new,) = fleet.state.links
    assert new.name != old.name


def test_robots_that_an_endpoint_lacks_are_stranded() -> None:
    fleet = wired()
    reconcile.left(fleet.state, "west")
    assert sync_of(fleet, "west", robots=["bob/r1", "ann/unknown"]).robots == ["bob/r1"]
    assert [robot.name for robot in reconcile.stranded(fleet.state)] == ["ann/r1"]
    assert len(fleet.state.links) == 0


def test_lost_endpoint_strands_its_robots() -> None:
    fleet = wired()
    reconcile.left(fleet.state, "west")
    plan, stranded = reconcile.endpoint_gone(fleet.state, "west")
    assert stranded == ["ann/r1", "bob/r1"]
    assert [type(call) for call in calls(plan, "ann/brain")] == [RemoveRoute, CloseLink]
    assert "ann/r1/pose" in fleet.state.interfaces
    reconcile.robot_left(fleet.state, "ann/r1")
    assert "ann/r1/pose" not in fleet.state.interfaces
    assert reconcile.robot_left(fleet.state, "ann/r1") == []


def test_interfaces_that_a_robot_added_for_its_own_go_with_it() -> None:
    fleet = furnished()
    for command in (
        interface("r1", "pose", "SubscriberConverter"),
        interface("brain", "pose", "PublisherInterface"),
        interface("brain", "unconnected", "PublisherInterface"),
        m.Connect("r1/pose", "brain/pose"),
    ):
        fleet.do("ann", command, robot="r1")
    plan = reconcile.robot_left(fleet.state, "ann/r1")
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
    reconcile.robot_left(fleet.state, "ann/r1")
    assert [each.tag for each in fleet.state.interfaces.by("ann/brain")] == ["pose", "shared"]


def test_interface_stays_while_a_connection_that_another_asked_for_waits() -> None:
    fleet = furnished()
    fleet.do("ann", interface("r1", "pose", "SubscriberConverter"), robot="r1")
    fleet.do("ann", interface("brain", "pose", "PublisherInterface"), robot="r1")
    fleet.do("ann", m.Connect("r1/pose", "brain/pose"))
    reconcile.robot_left(fleet.state, "ann/r1")
    assert [each.tag for each in fleet.state.interfaces.by("ann/brain")] == ["pose"]


# --- robots -----------------------------------------------------------------------------------------------------------


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
    reconcile.socket_moved(fleet.state, "ann/r1", False)
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
    reconcile.socket_moved(fleet.state, "ann/@guest", False)
    with pytest.raises(AlreadyExists):
        fleet.robot("ann/@guest", by="eve")


def test_robot_that_is_away_is_removed_or_resumes() -> None:
    fleet = wired()
    reconcile.socket_moved(fleet.state, "ann/r1", False)
    reconcile.socket_moved(fleet.state, "bob/r1", False)
    fleet.robot("ann/r1", session="t", resume="s")
    assert fleet.state.away == {"bob/r1"}
    reconcile.robot_left(fleet.state, "bob/r1")
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


# --- machines ---------------------------------------------------------------------------------------------------------


def test_machine_keeps_wanted_environments_and_starts_missing_ones() -> None:
    fleet = furnished()
    fleet.do("ann", m.CreateContainer("second"))
    runs = {each.name: each.run for each in fleet.state.environments}
    plan = fleet.join("m1", "container", capacity=4, environments={**runs, "ann/second": "older", "bob/x": "y"})
    assert calls(plan)[0] == KeepEnvironments([runs["ann/brain"]])
    (start,) = [call for call in calls(plan) if isinstance(call, StartEnvironment)]
    assert start.environment.name == "ann/second"
    assert start.environment.run not in ("older", runs["ann/second"])
    assert "ann/brain" in fleet.state.joined


def test_environment_with_restart_no_is_removed() -> None:
    fleet = furnished()
    fleet.do("ann", m.CreateContainer("once", m.ContainerData(restart="no")))
    fleet.do("ann", interface("once", "a", "PublisherInterface"))
    plan = fleet.join("m1", "container", capacity=4)
    started = [call.environment.name for call in calls(plan) if isinstance(call, StartEnvironment)]
    assert started == ["ann/brain"]
    assert "ann/once" not in fleet.state.environments
    assert "ann/once/a" not in fleet.state.interfaces


def test_environment_moves_to_a_connected_machine() -> None:
    fleet = furnished()
    fleet.join("m2", "container", capacity=4)
    environment = fleet.state.environments["ann/brain"]
    reconcile.left(fleet.state, "m1")
    reconcile.environment_down(fleet.state, environment)
    plan = reconcile.restart(fleet.state, environment, fleet.ids)
    assert [type(call) for call in calls(plan, "m2")] == [StartEnvironment]
    assert fleet.state.environments["ann/brain"].machine == "m2"


def test_environment_waits_for_its_machine_if_there_is_no_other() -> None:
    fleet = furnished()
    environment = fleet.state.environments["ann/brain"]
    reconcile.left(fleet.state, "m1")
    assert reconcile.restart(fleet.state, environment, fleet.ids) == []
    assert [type(call) for call in calls(fleet.join("m1", "container", capacity=4))] == [
        KeepEnvironments,
        StartEnvironment,
    ]


def test_machines_get_the_addresses_of_all_relays() -> None:
    fleet = Fleet()
    assert SetRelays not in map(type, calls(fleet.join("m1", "container")))
    plan = fleet.join("m2", "container", host="h2", relays={"h2": "m2:1"})
    assert [calls(plan, name)[-1] for name in ("m1", "m2")] == [SetRelays(["m2:1"])] * 2
    plan = fleet.join("m3", "container", host="h3", relays={"h3": "m3:1"})
    assert [calls(plan, name)[-1] for name in ("m1", "m2", "m3")] == [SetRelays(["m2:1", "m3:1"])] * 3
    reconcile.left(fleet.state, "m3")
    plan = fleet.join("m3", "container", "2", host="h3", relays={"h3": "m3:1"})
    assert (calls(plan, "m1"), calls(plan, "m3")[-1]) == ([], SetRelays(["m2:1", "m3:1"]))
