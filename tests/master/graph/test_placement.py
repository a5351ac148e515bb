"""Placement: machines of environments, by slots, features, GPUs and groups, and Robot endpoints of robots."""

from __future__ import annotations

import pytest

from master.graph import placement, reconcile
from master.graph.records import EnvironmentOptions
from master.graph.state import State
from rce.errors import NoCapacity, Unavailable
from rce.protocol import messages as m
from tests.support.master.fleet import Fleet
from tests.support.master.machines import machines, placed


def test_placement_prefers_the_users_machine_then_the_emptiest() -> None:
    fleet = machines(small=2, big=5)
    assert placed(fleet, "ann", "a", size=2) == "big"
    assert placed(fleet, "bob", "a", size=2) == "big"
    assert placed(fleet, "cid", "a") == "small"
    assert placed(fleet, "cid", "b") == "small"
    assert placed(fleet, "cid", "c") == "big"


def test_placement_considers_special_features() -> None:
    fleet = machines(big=9, special=1)
    assert placed(fleet, "ann", "a", specialFeatures=["gpu"]) == "special"
    with pytest.raises(NoCapacity) as raised:
        placed(fleet, "ann", "b", specialFeatures=["gpu"])
    assert raised.value.info.fields == {"asked": 1, "free": 0}


def test_missing_machines_and_endpoints_are_errors() -> None:
    with pytest.raises(NoCapacity, match="no machine"):
        placed(Fleet(), "ann", "a")
    with pytest.raises(Unavailable):
        placement.robot_endpoint(State())


def test_placement_considers_free_gpus() -> None:
    """The machine with more free slots has no GPUs."""
    fleet = Fleet()
    fleet.join("plain", "container", capacity=9)
    fleet.join("graphic", "container", capacity=3, gpus=2)
    fleet.do("ann", m.CreateContainer("one", m.ContainerData(gpus=1)))
    fleet.do("bob", m.CreateContainer("two", m.ContainerData(gpus=1)))
    assert {each.machine for each in fleet.state.environments} == {"graphic"}
    with pytest.raises(NoCapacity) as raised:
        fleet.do("bob", m.CreateContainer("three", m.ContainerData(gpus=1)))
    assert raised.value.info.fields == {"asked": 1, "free": 0}
    fleet.do("ann", m.DestroyContainer("one"))
    fleet.do("bob", m.CreateContainer("three", m.ContainerData(gpus=1)))


def test_free_slots_and_gpus_are_those_that_environments_leave() -> None:
    fleet = Fleet()
    fleet.join("m1", "container", capacity=5, gpus=2)
    placed(fleet, "ann", "a", size=3, gpus=2)
    machine = fleet.state.processes["m1"]
    assert (placement.free_slots(fleet.state, machine), placement.free_gpus(fleet.state, machine)) == (2, 0)


def test_slots_and_gpus_of_the_environment_that_moves_count_as_free() -> None:
    fleet = Fleet()
    fleet.join("only", "container", capacity=2, gpus=1)
    placed(fleet, "ann", "a", size=2, gpus=1)
    options = EnvironmentOptions(size=2, gpus=1)
    assert placement.place(fleet.state, "ann", options, "ann/a") == "only"
    with pytest.raises(NoCapacity):
        placement.place(fleet.state, "ann", options)


def test_machine_that_is_expected_back_is_waited_for() -> None:
    fleet = machines(only=2)
    reconcile.left(fleet.state, "only")
    assert placement.place(fleet.state, "ann", EnvironmentOptions()) == ""
    with pytest.raises(NoCapacity):
        placement.place(fleet.state, "ann", EnvironmentOptions(size=3))
    fleet.state.expected.discard("only")
    with pytest.raises(NoCapacity, match="no machine takes environments"):
        placement.place(fleet.state, "ann", EnvironmentOptions())


def test_connected_machine_is_preferred_to_a_better_one_that_is_away() -> None:
    fleet = machines(big=9, small=1)
    reconcile.left(fleet.state, "big")
    assert placed(fleet, "ann", "a") == "small"


def test_members_of_a_group_go_to_its_machine() -> None:
    fleet = machines(big=9, small=2)
    assert placed(fleet, "bob", "other", size=8) == "big"
    assert placed(fleet, "ann", "first", group="g") == "small"
    assert placed(fleet, "cid", "more", size=1) == "big"
    with pytest.raises(NoCapacity, match="machine small, which has network group g, has not 2 free slots"):
        placed(fleet, "ann", "second", group="g", size=2)
    fleet.join("special", "container", capacity=9, features=["gpu"])
    with pytest.raises(NoCapacity, match="small, which does not offer the special features gpu"):
        placed(fleet, "ann", "second", group="g", specialFeatures=["gpu"])


def test_machine_that_shrank_has_no_free_slots() -> None:
    """It joined again with fewer slots and GPUs than its environments use."""
    fleet = machines(only=4)
    placed(fleet, "ann", "a", size=4)
    fleet.join("only", "container", "2", capacity=1, environments={"ann/a": fleet.state.environments["ann/a"].run})
    with pytest.raises(NoCapacity) as raised:
        placed(fleet, "ann", "b")
    assert raised.value.info.fields == {"asked": 1, "free": 0}


def test_robot_endpoint_with_the_fewest_robots_is_chosen() -> None:
    fleet = Fleet()
    for name in ("west", "east", "north"):
        fleet.join(name, "robot")
    reconcile.left(fleet.state, "north")
    chosen = []
    for number in range(4):
        name = placement.robot_endpoint(fleet.state).name
        chosen.append(name)
        fleet.robot(f"ann/r{number}", name)
    assert chosen == ["east", "west", "east", "west"]
