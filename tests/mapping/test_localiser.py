from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from rce.mapping.geometry import Pose
from rce.mapping.graph_mapper import GraphMapper
from rce.mapping.grid import OccupancyGrid
from rce.mapping.localiser import Localiser
from rce.mapping.scans import Scan
from rce.mapping.simulation import Simulation


@pytest.fixture(scope="module")
def known(simulation: Simulation) -> tuple[OccupancyGrid, np.ndarray]:
    """The map of the apartment, and the poses in it."""
    mapper = GraphMapper()
    for scan in simulation:
        mapper.add(scan)
    return mapper.grid(), mapper.trajectory()


def errors(localiser: Localiser, truth: np.ndarray) -> np.ndarray:
    found = localiser.trajectory()
    rows = np.searchsorted(truth[:, 0], found[:, 0])
    return np.hypot(*(found[:, 1:3] - truth[rows, 1:3]).T)


def without_odometry(scans: list[Scan]) -> list[Scan]:
    return [dataclasses.replace(scan, odometry=None) for scan in scans]


@pytest.mark.parametrize("start", [0, 400, 650])
def test_a_robot_is_found_anywhere_and_followed(simulation: Simulation, known: tuple, start: int) -> None:
    grid, truth = known
    localiser = Localiser(grid)
    assert localiser.lost
    scans = simulation.records[start : start + 200]
    answers = [localiser.add(scan) for scan in scans]
    assert not localiser.lost
    assert sum(answer.taken for answer in answers) > 120
    assert len(localiser.trajectory()) == sum(answer.taken for answer in answers)
    assert errors(localiser, truth).max() < 0.15


def test_an_initial_pose_need_not_be_exact_and_odometry_is_optional(simulation: Simulation, known: tuple) -> None:
    grid, truth = known
    initial = Pose(*truth[300, 1:]) @ Pose(0.6, -0.4, math.radians(20))
    localiser = Localiser(grid, initial)
    assert all(localiser.add(scan).taken for scan in without_odometry(simulation.records[300:400]))
    assert errors(localiser, truth).max() < 0.15


def test_a_robot_that_was_carried_off_is_lost_and_found_again(simulation: Simulation, known: tuple) -> None:
    grid, truth = known
    localiser = Localiser(grid, Pose(*truth[0, 1:]))
    for scan in simulation.records[:60]:
        localiser.add(scan)
    states = []
    for scan in simulation.records[700:900]:
        answer = localiser.add(dataclasses.replace(scan, odometry=None))
        states.append(localiser.lost)
        assert answer.taken != localiser.lost
        assert not localiser.lost or answer.covariance[0, 0] > 1e3
    assert any(states)
    assert not localiser.lost
    assert errors(localiser, truth)[-20:].max() < 0.15


def test_what_is_in_no_map_is_not_found(simulation: Simulation, known: tuple) -> None:
    """A round room, which the apartment has not."""
    grid, _ = known
    localiser = Localiser(grid)
    template = simulation.records[0]
    for i in range(40):
        ranges = np.full(360, 6.0 + 0.05 * i % 2, np.float32)
        localiser.add(dataclasses.replace(template, stamp=float(i), ranges=ranges, odometry=Pose(0.3 * i, 0.0, 0.0)))
    assert localiser.lost
    assert localiser.trajectory().shape == (0, 4)


def test_late_scans_are_dropped(simulation: Simulation, known: tuple) -> None:
    grid, truth = known
    localiser = Localiser(grid, Pose(*truth[0, 1:]))
    for scan in simulation.records[:5]:
        localiser.add(scan)
    late = localiser.add(simulation.records[2])
    assert not late.taken
    assert len(localiser.trajectory()) == 5
