"""What the Master knows of the platform, counted for Prometheus; and what the platform lacks."""

from __future__ import annotations

from collections import Counter
from typing import get_args

from master.records import State
from master.shown import Shown
from rce.metrics import Family, gauge
from rce.views.resources import EnvironmentState

LACKS = {
    "robot": "no Robot endpoint has joined: robots cannot be served",
    "container": "no Container task set has joined: environments cannot be started",
}


def families(shown: Shown) -> list[Family]:
    """Counts by state, zeros too."""
    state = shown.state
    environments = Counter(shown.environment(each).state for each in state.environments)
    processes = Counter((each.role, each.name in state.joined) for each in state.processes)
    roles = sorted({role for role, _ in processes})
    up = sum(bool(each.link) for each in state.connections)
    return [
        gauge(
            "rce_processes",
            "Processes of the platform that have joined, and those that are away",
            ["role", "state"],
            {
                (role, name): processes[role, joined]
                for role in roles
                for name, joined in (("joined", True), ("away", False))
            },
        ),
        gauge(
            "rce_environments",
            "Environments by how far they have come",
            ["state"],
            {(each,): environments[each] for each in get_args(EnvironmentState)},
        ),
        gauge("rce_robots", "Robots with a session", [], {(): len(state.robots)}),
        gauge("rce_interfaces_wanted", "Interfaces that robots and environments have", [], {(): len(state.interfaces)}),
        gauge(
            "rce_connections",
            "Connections by whether both sides are there",
            ["state"],
            {("up",): up, ("down",): len(state.connections) - up},
        ),
    ]


def lacking(state: State) -> list[str]:
    """Why the platform cannot do what it is for, as far as processes matter."""
    there = {each.role for each in state.processes if each.name in state.joined}
    return [reason for role, reason in LACKS.items() if role not in there]
