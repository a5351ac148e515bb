"""Inventory: counts for Prometheus, and what the platform lacks."""

from __future__ import annotations

import pytest

from master.execution.readiness import Readiness
from master.graph import reconcile, sessions
from master.graph.records import Role, ref
from master.graph.state import State
from master.live import inventory
from master.live.presenter import Presenter
from rce.protocol import messages as m
from tests.support.master.fleet import Fleet, full
from tests.support.master.offers import offering


def counts(state: State, readiness: Readiness | None = None) -> dict[str, dict[tuple[str, ...], float]]:
    """Return the values of all families by name and label values."""
    families = inventory.families(Presenter(state, readiness or Readiness()))
    assert {family.kind for family in families} == {"gauge", "counter"}
    return {family.name: {tuple(each.labels): each.value for each in family.samples} for family in families}


def test_parts_are_counted_by_state() -> None:
    fleet, readiness = full(), Readiness()
    readiness.mark_ready(ref(fleet.state.environments["ann/brain"]))
    fleet.join("m2", "container")
    reconcile.left(fleet.state, "m2")
    found = counts(fleet.state, readiness)
    assert found["rce_environments"] == {("waiting",): 0, ("starting",): 0, ("ready",): 1, ("away",): 0}
    assert found["rce_processes"] == {
        ("container", "joined"): 1,
        ("container", "away"): 1,
        ("environment", "joined"): 1,
        ("environment", "away"): 0,
        ("robot", "joined"): 1,
        ("robot", "away"): 0,
    }
    assert (found["rce_robots"][()], found["rce_interfaces_wanted"][()]) == (2, 7)
    assert found["rce_connections"] == {("up",): 2, ("down",): 0}
    sessions.endpoint_gone(fleet.state, "west")
    assert counts(fleet.state)["rce_connections"] == {("up",): 0, ("down",): 2}


def test_empty_platform_has_zeros() -> None:
    found = counts(State())
    assert found.pop("rce_processes") == {}
    assert {value for family in found.values() for value in family.values()} == {0}


def test_services_are_counted() -> None:
    fleet, offer = offering()
    fleet.do("bob", m.UseService(offer.name), robot="r1")
    found = counts(fleet.state)
    for name in ("rce_service_instances", "rce_service_robots"):
        assert found[name] == {("ann/parrot",): 1}
    (uses,) = [name for name in found if name.startswith("rce_service_uses")]
    assert found[uses] == {("ann/parrot", "bob"): 1}


@pytest.mark.parametrize(
    ("roles", "lacking"),
    [
        ([], ["Robot endpoint", "Container task set"]),
        (["robot"], ["Container task set"]),
        (["container"], ["Robot endpoint"]),
        (["robot", "container"], []),
    ],
)
def test_processes_that_have_not_joined_are_missing(roles: list[Role], lacking: list[str]) -> None:
    fleet = Fleet()
    for role in roles:
        fleet.join(role, role)
    sentences = inventory.missing_parts(fleet.state)
    assert len(sentences) == len(lacking)
    assert all(part in sentence for part, sentence in zip(lacking, sentences, strict=True))


def test_process_that_is_away_is_missing() -> None:
    fleet = Fleet()
    fleet.join("west", "robot")
    fleet.join("m1", "container")
    reconcile.left(fleet.state, "west")
    assert inventory.missing_parts(fleet.state) == ["no Robot endpoint has joined: robots cannot be served"]
