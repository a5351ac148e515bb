"""Inventory: counts of the platform's parts for Prometheus, and what the platform lacks."""

from __future__ import annotations

from collections import Counter
from typing import get_args

from master.graph.state import State
from master.live.presenter import Presenter
from rce.api.views.resources import EnvironmentState
from rce.process.metrics import Family, counter_family, gauge_family

LACKS = {
    "robot": "no Robot endpoint has joined: robots cannot be served",
    "container": "no Container task set has joined: environments cannot be started",
}


def families(presenter: Presenter) -> list[Family]:
    """Return counts by state, including zeros."""
    state = presenter.state
    environments = Counter(presenter.environment(each).state for each in state.environments)
    processes = Counter((each.role, each.name in state.joined) for each in state.processes)
    roles = sorted({role for role, _ in processes})
    up = sum(bool(each.link) for each in state.connections)
    return [
        gauge_family(
            "rce_processes",
            "Processes of the platform that have joined, and those that are away",
            ["role", "state"],
            {
                (role, name): processes[role, joined]
                for role in roles
                for name, joined in (("joined", True), ("away", False))
            },
        ),
        gauge_family(
            "rce_environments",
            "Environments by state",
            ["state"],
            {(each,): environments[each] for each in get_args(EnvironmentState)},
        ),
        gauge_family("rce_robots", "Robots with a session", [], {(): len(state.robots)}),
        gauge_family("rce_interfaces_wanted", "Interfaces of robots and environments", [], {(): len(state.interfaces)}),
        gauge_family(
            "rce_connections",
            "Connections by state",
            ["state"],
            {("up",): up, ("down",): len(state.connections) - up},
        ),
        *_of_services(state),
    ]


def _of_services(state: State) -> list[Family]:
    """Return the counts of services of the catalogue that are in use."""
    instances = Counter(each.offer for each in state.instances)
    robots = Counter(each.offer for each in state.uses)
    of_service = [(each.name,) for each in state.offers]
    uses: dict[tuple[str, ...], float] = {(each.offer, each.user): each.uses for each in state.tallies}
    return [
        gauge_family(
            "rce_service_instances",
            "Instances of a service of the catalogue",
            ["service"],
            {each: instances[each[0]] for each in of_service},
        ),
        gauge_family(
            "rce_service_robots",
            "Robots that use a service of the catalogue",
            ["service"],
            {each: robots[each[0]] for each in of_service},
        ),
        counter_family(
            "rce_service_uses", "How often robots of a user began to use a service", ["service", "user"], uses
        ),
    ]


def missing_parts(state: State) -> list[str]:
    """Return sentences about the processes without which the platform cannot work."""
    there = {each.role for each in state.processes if each.name in state.joined}
    return [reason for role, reason in LACKS.items() if role not in there]
