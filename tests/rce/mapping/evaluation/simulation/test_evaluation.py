"""Accuracy of maps and trajectories against a simulation."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rce.mapping.evaluation.simulation import Simulation, evaluate
from rce.mapping.evaluation.simulation.evaluation import alignment
from rce.mapping.geometry import Pose
from rce.mapping.grid import OccupancyGrid


def perfect(simulation: Simulation) -> OccupancyGrid:
    """Return a map with exactly the walls that were seen, in the frame of the building."""
    cells = np.full((240, 340), 0, np.int8)
    columns, rows = np.floor((simulation.seen + 0.5) / 0.05).astype(int).T
    cells[rows, columns] = 100
    return OccupancyGrid(cells, 0.05, -0.5, -0.5)


def test_ground_truth_has_no_error(simulation: Simulation) -> None:
    accuracy = evaluate(perfect(simulation), simulation.truth, simulation)
    assert accuracy == pytest.approx(dataclasses.replace(accuracy, translation=0.0, rotation=0.0))
    assert (accuracy.walls_found, accuracy.walls_true) == (1.0, 1.0)


def test_errors_are_measured(simulation: Simulation) -> None:
    grid, worse = perfect(simulation), simulation.truth.copy()
    worse[::2, 1] += 0.2
    worse[:, 3] += 0.1
    shifted = OccupancyGrid(np.roll(grid.cells, 8, axis=0), 0.05, -0.5, -0.5)
    accuracy = evaluate(shifted, worse, simulation)
    assert accuracy.translation == pytest.approx(0.1, abs=0.01)
    assert accuracy.rotation == pytest.approx(0.1, abs=0.01)
    assert accuracy.walls_found < 0.8
    assert accuracy.walls_true < 0.8


def test_trajectory_of_another_length_is_rejected(simulation: Simulation) -> None:
    with pytest.raises(ValueError, match="poses"):
        evaluate(perfect(simulation), simulation.truth[:-1], simulation)


def test_alignment_finds_the_pose() -> None:
    points = np.random.default_rng(0).normal(size=(20, 2))
    pose = Pose(3.0, -1.0, 2.0)
    assert alignment(points, pose.transform(points)) == pytest.approx(pose)


def test_map_without_walls_is_not_accurate(simulation: Simulation) -> None:
    empty = OccupancyGrid(np.zeros((3, 3), np.int8), 0.05, 0.0, 0.0)
    accuracy = evaluate(empty, simulation.truth, simulation)
    assert (accuracy.walls_found, accuracy.walls_true) == (0.0, 0.0)


def test_frame_of_the_map_does_not_matter(simulation: Simulation) -> None:
    """A mapper begins at the origin, wherever the robot is in the building."""
    start, moved = Pose(-30.0, 8.0, 0.0), simulation.truth.copy()
    moved[:, 1:3] = start.transform(simulation.truth[:, 1:3])
    grid = perfect(simulation)
    shifted = OccupancyGrid(grid.cells, grid.resolution, grid.x + start.x, grid.y + start.y)
    accuracy = evaluate(shifted, moved, simulation)
    assert accuracy.translation < 1e-9
    assert (accuracy.walls_found, accuracy.walls_true) == pytest.approx((1.0, 1.0), abs=1e-3)
