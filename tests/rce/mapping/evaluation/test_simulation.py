from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from rce.mapping.evaluation.simulation import Simulation, evaluate, simulate
from rce.mapping.evaluation.simulation.evaluation import alignment
from rce.mapping.evaluation.simulation.floor_plan import LOWER_WALLS, UPPER_WALLS, WIDTH, FloorPlan, apartment
from rce.mapping.geometry import Pose
from rce.mapping.grid import OccupancyGrid


def test_drive_takes_one_to_two_minutes_and_visits_all_rooms(simulation: Simulation) -> None:
    assert 60 < simulation.duration < 120
    assert simulation.scans == len(list(simulation)) == len(simulation.truth)
    for walls, inside in ((LOWER_WALLS, simulation.truth[:, 2] < 4), (UPPER_WALLS, simulation.truth[:, 2] > 7)):
        for left, right in zip((0.0, *walls), (*walls, WIDTH), strict=True):
            x = simulation.truth[inside, 1]
            assert ((x > left) & (x < right)).any()


def test_robot_keeps_clear_of_walls(simulation: Simulation) -> None:
    assert simulation.plan.distance(simulation.truth[:, 1:3]).min() > 0.2


def test_beams_end_on_walls(simulation: Simulation) -> None:
    for i in range(0, simulation.scans, 97):
        ends = Pose(*simulation.truth[i, 1:]).transform(simulation.records[i].points(100.0))
        assert simulation.plan.distance(ends).max() < 0.06


def test_ranges_in_a_square_room_are_exact() -> None:
    corners = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    room = FloorPlan(np.stack([corners, np.roll(corners, -1, axis=0)], axis=1))
    np.testing.assert_allclose(room.ranges(1.0, 1.0, math.pi / 2, 4, 2 * math.pi), [1.0, 3.0, 3.0, 1.0])
    np.testing.assert_allclose(room.distance(np.array([[1.0, 2.0], [5.0, 4.0]])), [1.0, 1.0])


def test_odometry_drift_is_bounded(simulation: Simulation) -> None:
    wheels, truth = simulation.records[-1].odometry, simulation.truth
    assert wheels
    end = Pose(*truth[0, 1:]).to(Pose(*truth[-1, 1:]))
    assert 0.5 < math.dist(wheels[:2], end[:2]) < 15


def test_seed_determines_the_simulation(simulation: Simulation) -> None:
    again, other = simulate(0), simulate(1)
    np.testing.assert_array_equal(again.records[100].ranges, simulation.records[100].ranges)
    assert again.records[-1].odometry == simulation.records[-1].odometry
    assert other.records[-1].odometry != simulation.records[-1].odometry


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


def test_apartment_has_six_rooms() -> None:
    assert len(LOWER_WALLS) + len(UPPER_WALLS) + 2 == 6
    assert apartment().walls.shape[1:] == (2, 2)
