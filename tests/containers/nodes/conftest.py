"""Fixtures of the tests of ROS 2 nodes."""

from __future__ import annotations

import pytest

from rce.mapping.evaluation.simulation import Simulation, simulate


@pytest.fixture(scope="session")
def simulation() -> Simulation:
    return simulate()
