"""Machines with slots, and where environments are placed on them."""

from __future__ import annotations

from typing import Any

from rce.protocol import messages as m
from tests.support.master.fleet import Fleet


def machines(**capacities: int) -> Fleet:
    fleet = Fleet()
    for name, capacity in capacities.items():
        fleet.join(name, "container", capacity=capacity, features=["gpu"] if name == "special" else [])
    return fleet


def placed(fleet: Fleet, user: str, tag: str, **options: Any) -> str:
    fleet.do(user, m.CreateContainer(tag, m.ContainerData(**options)))
    return fleet.state.environments[f"{user}/{tag}"].machine
