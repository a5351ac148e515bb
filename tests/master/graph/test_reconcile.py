"""Reconciliation of processes that join, leave and return."""

from __future__ import annotations

from typing import Any

from master.graph import reconcile, sessions
from master.graph.records import Role
from rce.control.calls.endpoints import AddRoute, CloseLink, OpenLink, RemoveRoute, Sync
from rce.control.calls.environments import KeepEnvironments, SetRelays, StartEnvironment
from rce.control.calls.joining import SetRemovedUsers
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
    assert [robot.name for robot in sessions.stranded(fleet.state)] == ["ann/r1"]
    assert len(fleet.state.links) == 0


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


def test_process_that_keeps_things_of_users_is_told_who_was_removed() -> None:
    fleet = furnished()
    fleet.state.removed_users = {"eve": 1.0}
    told = SetRemovedUsers({"eve": 1.0})
    assert told in calls(fleet.join("maps", "service"), "maps")
    assert told in calls(fleet.join("m9", "container"), "m9")
    assert told not in calls(fleet.join("east", "robot"), "east")
    plan = reconcile.announce_removed_users(fleet.state)
    assert (calls(plan, "maps"), calls(plan, "m9"), calls(plan, "east")) == ([told], [told], [])
