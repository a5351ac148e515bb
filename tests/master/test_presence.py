"""Processes and robots that come, go and come back; where environments are placed."""

from __future__ import annotations

import pytest
from fleet import Fleet, calls, everything, furnished, interface, wired

from master import placement, presence
from master.records import State
from rce import messages as m
from rce.calls.endpoints import AddRoute, Bind, CloseLink, OpenLink, RemoveRoute, Sync
from rce.calls.environments import KeepEnvironments, KnowRelays, StartEnvironment
from rce.calls.robots import DropRobot
from rce.errors import AlreadyExists, InvalidName, NoCapacity, Unavailable


def sync_of(fleet: Fleet, to: str, role: str = "robot", incarnation: str = "1", **hello: object) -> Sync:
    plan = fleet.join(to, role, incarnation, **hello)  # type: ignore[arg-type]
    (sync,) = [call for call in calls(plan, to) if isinstance(call, Sync)]
    return sync


# --- endpoints --------------------------------------------------------------------------------------------------------


def test_a_process_that_was_out_of_sight_keeps_its_links() -> None:
    fleet = wired()
    before = everything(fleet.state)
    presence.left(fleet.state, "ann/brain")
    plan = fleet.join("ann/brain", "environment", host="h2")
    (sync,) = calls(plan)
    assert isinstance(sync, Sync)
    assert (len(sync.interfaces), len(sync.links), len(sync.routes)) == (1, 1, 1)
    assert everything(fleet.state) == before


def test_a_restarted_process_gets_links_anew() -> None:
    fleet = wired()
    (old,) = fleet.state.links
    presence.left(fleet.state, "ann/brain")
    plan = fleet.join("ann/brain", "environment", "2")
    (new,) = fleet.state.links
    assert (new.name != old.name, new.incarnations) == (True, ("1", "2"))
    assert {type(call) for call in calls(plan, "west")} == {RemoveRoute, CloseLink, OpenLink, AddRoute}


def test_a_restarted_robot_endpoint_that_says_it_has_its_robots_gets_links_anew() -> None:
    fleet = wired()
    (old,) = fleet.state.links
    presence.left(fleet.state, "west")
    fleet.join("west", "robot", "2", robots=["ann/r1", "bob/r1"])
    (new,) = fleet.state.links
    assert new.name != old.name


def test_robots_that_an_endpoint_has_not_are_stranded() -> None:
    fleet = wired()
    presence.left(fleet.state, "west")
    assert sync_of(fleet, "west", robots=["bob/r1", "ann/unknown"]).robots == ["bob/r1"]
    assert [robot.name for robot in presence.stranded(fleet.state)] == ["ann/r1"]
    assert len(fleet.state.links) == 0


def test_an_endpoint_that_stays_away_strands_its_robots() -> None:
    fleet = wired()
    presence.left(fleet.state, "west")
    plan, stranded = presence.endpoint_gone(fleet.state, "west")
    assert stranded == ["ann/r1", "bob/r1"]
    assert [type(call) for call in calls(plan, "ann/brain")] == [RemoveRoute, CloseLink]
    assert "ann/r1/pose" in fleet.state.interfaces
    presence.robot_left(fleet.state, "ann/r1")
    assert "ann/r1/pose" not in fleet.state.interfaces
    assert presence.robot_left(fleet.state, "ann/r1") == []


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
def test_robots_that_are_refused(name: str, resume: str, error: type[Exception]) -> None:
    fleet = wired()
    before = everything(fleet.state)
    with pytest.raises(error):
        fleet.robot(name, resume=resume)
    assert everything(fleet.state) == before


def test_a_robot_resumes_where_it_was() -> None:
    fleet = wired()
    outcome, resumed = fleet.robot("ann/r1", session="t", resume="s")
    assert (outcome.plan, resumed) == ([], True)
    with pytest.raises(AlreadyExists):
        fleet.robot("ann/r1", session="u", resume="s")  # each token is good once


def test_a_robot_that_is_away_is_forgotten_or_comes_back() -> None:
    fleet = wired()
    presence.socket_moved(fleet.state, "ann/r1", False)
    presence.socket_moved(fleet.state, "bob/r1", False)
    fleet.robot("ann/r1", session="t", resume="s")
    assert fleet.state.away == {"bob/r1"}
    presence.robot_left(fleet.state, "bob/r1")
    assert fleet.state.away == set()


def test_a_robot_resumes_elsewhere_with_all_it_has() -> None:
    fleet = wired()
    fleet.join("east", "robot")
    outcome, resumed = fleet.robot("ann/r1", "east", "t", "s")
    assert resumed
    assert [type(call) for call in calls(outcome.plan, "east")] == [Bind, OpenLink, AddRoute]
    assert DropRobot("ann/r1", "resumed elsewhere") in calls(outcome.plan, "west")
    (link,) = fleet.state.links
    assert "east" in (link.listener, link.dialler)


# --- machines ---------------------------------------------------------------------------------------------------------


def test_a_machine_keeps_what_is_wanted_and_starts_what_is_missing() -> None:
    fleet = furnished()
    fleet.do("ann", m.CreateContainer("second"))
    runs = {each.name: each.run for each in fleet.state.environments}
    plan = fleet.join("m1", "container", capacity=4, environments={**runs, "ann/second": "older", "bob/x": "y"})
    assert calls(plan)[0] == KeepEnvironments([runs["ann/brain"]])
    (start,) = [call for call in calls(plan) if isinstance(call, StartEnvironment)]
    assert start.environment.name == "ann/second"
    assert start.environment.run not in ("older", runs["ann/second"])
    assert "ann/brain" in fleet.state.joined


def test_what_shall_not_be_restarted_is_not() -> None:
    fleet = furnished()
    fleet.do("ann", m.CreateContainer("once", m.ContainerData(restart="no")))
    fleet.do("ann", interface("once", "a", "PublisherInterface"))
    plan = fleet.join("m1", "container", capacity=4)
    started = [call.environment.name for call in calls(plan) if isinstance(call, StartEnvironment)]
    assert started == ["ann/brain"]
    assert "ann/once" not in fleet.state.environments
    assert "ann/once/a" not in fleet.state.interfaces


def test_an_environment_moves_to_a_machine_that_is_there() -> None:
    fleet = furnished()
    fleet.join("m2", "container", capacity=4)
    environment = fleet.state.environments["ann/brain"]
    presence.left(fleet.state, "m1")
    presence.environment_down(fleet.state, environment)
    plan = presence.restart(fleet.state, environment, fleet.ids)
    assert [type(call) for call in calls(plan, "m2")] == [StartEnvironment]
    assert fleet.state.environments["ann/brain"].machine == "m2"


def test_without_a_machine_it_waits_for_its_own() -> None:
    fleet = furnished()
    environment = fleet.state.environments["ann/brain"]
    presence.left(fleet.state, "m1")
    assert presence.restart(fleet.state, environment, fleet.ids) == []
    assert [type(call) for call in calls(fleet.join("m1", "container", capacity=4))] == [
        KeepEnvironments,
        StartEnvironment,
    ]


def test_machines_are_told_of_each_others_relays() -> None:
    fleet = Fleet()
    assert KnowRelays not in map(type, calls(fleet.join("m1", "container")))
    plan = fleet.join("m2", "container", addresses=["relay:m2:1"])
    assert [calls(plan, name)[-1] for name in ("m1", "m2")] == [KnowRelays(["m2:1"])] * 2
    plan = fleet.join("m3", "container", addresses=["relay:m3:1"])
    assert [calls(plan, name)[-1] for name in ("m1", "m2", "m3")] == [KnowRelays(["m2:1", "m3:1"])] * 3
    presence.left(fleet.state, "m3")
    plan = fleet.join("m3", "container", "2", addresses=["relay:m3:1"])
    assert (calls(plan, "m1"), calls(plan, "m3")[-1]) == ([], KnowRelays(["m2:1", "m3:1"]))


# --- placement --------------------------------------------------------------------------------------------------------


def machines(**capacities: int) -> Fleet:
    fleet = Fleet()
    for name, capacity in capacities.items():
        fleet.join(name, "container", capacity=capacity, features=["gpu"] if name == "special" else [])
    return fleet


def placed(fleet: Fleet, user: str, tag: str, **options: object) -> str:
    fleet.do(user, m.CreateContainer(tag, m.ContainerData(**options)))  # type: ignore[arg-type]
    return fleet.state.environments[f"{user}/{tag}"].machine


def test_the_emptiest_machine_then_the_one_that_has_the_user() -> None:
    fleet = machines(small=2, big=5)
    assert placed(fleet, "ann", "a", size=2) == "big"
    assert placed(fleet, "bob", "a", size=2) == "big"
    assert placed(fleet, "cid", "a") == "small"
    assert placed(fleet, "cid", "b") == "small"
    assert placed(fleet, "cid", "c") == "big"


def test_special_features() -> None:
    fleet = machines(big=9, special=1)
    assert placed(fleet, "ann", "a", specialFeatures=["gpu"]) == "special"
    with pytest.raises(NoCapacity) as raised:
        placed(fleet, "ann", "b", specialFeatures=["gpu"])
    assert raised.value.info.fields == {"asked": 1, "free": 0}


def test_no_machine_and_no_endpoint() -> None:
    with pytest.raises(NoCapacity, match="no machine"):
        placed(Fleet(), "ann", "a")
    with pytest.raises(Unavailable):
        placement.robot_endpoint(State())
