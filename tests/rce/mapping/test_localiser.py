from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.geometry import Pose
from rce.mapping.grid import OccupancyGrid
from rce.mapping.localiser import Localiser
from rce.mapping.pose_graph.mapper import GraphMapper
from rce.mapping.scans import Scan

Known = tuple[OccupancyGrid, NDArray[np.float64]]


@pytest.fixture(scope="module")
def known(simulation: Simulation) -> Known:
    """Map of the apartment, and the trajectory in it."""
    mapper = GraphMapper()
    for scan in simulation:
        mapper.add(scan)
    return mapper.grid(), mapper.trajectory()


def errors(localiser: Localiser, truth: NDArray[np.float64]) -> NDArray[np.float64]:
    found = localiser.trajectory()
    rows = np.searchsorted(truth[:, 0], found[:, 0])
    off: NDArray[np.float64] = np.hypot(*(found[:, 1:3] - truth[rows, 1:3]).T)
    return off


def without_odometry(scans: list[Scan]) -> list[Scan]:
    return [dataclasses.replace(scan, odometry=None) for scan in scans]


@pytest.mark.slow
@pytest.mark.parametrize("start", [0, 400, 650])
def test_robot_is_found_anywhere_and_tracked(simulation: Simulation, known: Known, start: int) -> None:
    grid, truth = known
    localiser = Localiser(grid)
    assert localiser.lost
    scans = simulation.records[start : start + 200]
    answers = [localiser.add(scan) for scan in scans]
    assert not localiser.lost
    assert sum(answer.accepted for answer in answers) > 120
    assert len(localiser.trajectory()) == sum(answer.accepted for answer in answers)
    assert errors(localiser, truth).max() < 0.15


def test_initial_pose_may_be_inexact_without_odometry(simulation: Simulation, known: Known) -> None:
    grid, truth = known
    initial = Pose(*truth[300, 1:]) @ Pose(0.6, -0.4, math.radians(20))
    localiser = Localiser(grid, initial)
    assert all(localiser.add(scan).accepted for scan in without_odometry(simulation.records[300:400]))
    assert errors(localiser, truth).max() < 0.15


def test_robot_that_was_carried_away_is_found_again(simulation: Simulation, known: Known) -> None:
    grid, truth = known
    localiser = Localiser(grid, Pose(*truth[0, 1:]))
    for scan in simulation.records[:60]:
        localiser.add(scan)
    states = []
    for scan in simulation.records[700:900]:
        answer = localiser.add(dataclasses.replace(scan, odometry=None))
        states.append(localiser.lost)
        assert answer.accepted != localiser.lost
        assert not localiser.lost or answer.covariance[0, 0] > 1e3
    assert any(states)
    assert not localiser.lost
    assert errors(localiser, truth)[-20:].max() < 0.15


def test_place_outside_the_map_is_not_found(simulation: Simulation, known: Known) -> None:
    """The apartment has no round room."""
    grid, _ = known
    localiser = Localiser(grid)
    template = simulation.records[0]
    for i in range(40):
        ranges = np.full(360, 6.0 + 0.05 * i % 2, np.float32)
        localiser.add(dataclasses.replace(template, stamp=float(i), ranges=ranges, odometry=Pose(0.3 * i, 0.0, 0.0)))
    assert localiser.lost
    assert localiser.trajectory().shape == (0, 4)


def test_late_scans_are_not_accepted(simulation: Simulation, known: Known) -> None:
    grid, truth = known
    localiser = Localiser(grid, Pose(*truth[0, 1:]))
    for scan in simulation.records[:5]:
        localiser.add(scan)
    late = localiser.add(simulation.records[2])
    assert not late.accepted
    assert len(localiser.trajectory()) == 5
