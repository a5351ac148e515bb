"""Endless run of a mapper."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.evaluation.trials import (
    endless,
    flatness,
)
from rce.mapping.evaluation.trials.endless import back_and_forth
from rce.mapping.pose_graph.mapper import GraphMapper


def test_endless_run_does_not_jump_and_is_measured(simulation: Simulation) -> None:
    scans = simulation.records[:50]
    stream = list(back_and_forth(scans, 160))
    assert np.diff([scan.stamp for scan in stream]) == pytest.approx(0.1)
    jumps = [a.odometry.to(b.odometry) for a, b in pairwise(stream) if a.odometry and b.odometry]
    assert max(math.hypot(jump.x, jump.y) for jump in jumps) < 0.2
    measured = endless(GraphMapper, scans, 200)
    assert len(measured.scans) == 100
    assert flatness(measured.memory) < 1.2
    assert (measured.seconds >= 0).all()


@pytest.mark.parametrize(("values", "flat"), [([5.0] * 40, 1.0), (list(range(1, 41)), 35.5 / 15.5)])
def test_flatness_compares_the_end_with_the_beginning(values: list[float], flat: float) -> None:
    assert flatness(np.array(values)) == pytest.approx(flat)


def test_beginning_of_a_run_does_not_count() -> None:
    """A mapper grows at first, while it sees the building for the first time."""
    assert flatness(np.array([0.0] * 10 + [5.0] * 30)) == 1.0
