"""The planner `hybrid`."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from rce.api.map_jobs import MOTION_MODELS, MotionModel
from rce.bench.planning import building
from rce.mapping.geometry import Pose
from rce.planning.costmap import OCCUPIED, Costmap
from rce.planning.failures import NoPath, Reason
from rce.planning.footprint import Footprint
from rce.planning.hybrid import Vehicle, hybrid
from rce.planning.search.deadline import Deadline
from tests.support.planning import ROBOT, random_map, walled

CAR = Footprint.polygon(((0.35, 0.2), (0.35, -0.2), (-0.25, -0.2), (-0.25, 0.2)))


def collides(costmap_grid: object, poses: NDArray[np.float64], footprint: Footprint) -> bool:
    """Return whether the footprint at any pose has an obstacle of the map in it, point by point."""
    from rce.mapping.grid import OccupancyGrid

    assert isinstance(costmap_grid, OccupancyGrid)
    samples = footprint.samples(costmap_grid.resolution / 2)
    return any(
        (costmap_grid.at(Pose(x, y, theta).transform(samples)) >= OCCUPIED).any() for x, y, theta, _ in poses.tolist()
    )


@pytest.mark.parametrize("model", MOTION_MODELS)
def test_path_in_a_building_is_free_and_can_be_driven(model: MotionModel) -> None:
    grid = building()
    vehicle = Vehicle(0.5, model)
    start, goal = Pose(1.0, 5.5, 0.0), Pose(15.0, 9.0, 1.57)
    poses, length = hybrid(Costmap(grid, CAR), start, goal, vehicle, Deadline(60))
    assert np.allclose(poses[0, :3], start)
    assert np.allclose(poses[-1, :2], goal[:2], atol=1e-6)
    assert math.isclose(poses[-1, 2], 1.57, abs_tol=1e-6)
    assert not collides(grid, poses, CAR)
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    turns = np.abs((np.diff(poses[:, 2]) + np.pi) % (2 * np.pi) - np.pi)
    assert steps.max() <= grid.resolution + 1e-9
    assert (turns <= 1.01 * steps / 0.5 + 1e-6).all()  # a chord is a little shorter than its arc
    assert math.isclose(length, steps.sum(), rel_tol=1e-9)
    assert 14 < length < 20
    if model == "DUBIN":
        assert (poses[:, 3] == 1).all()


@pytest.mark.parametrize("seed", range(5))
def test_paths_on_random_maps_are_free(seed: int) -> None:
    grid = random_map(seed, 120, 0.004)
    cells = grid.cells.copy()
    cells[:25, :25] = cells[-25:, -25:] = 0
    grid = type(grid)(cells, grid.resolution, 0.0, 0.0)
    vehicle = Vehicle(0.5, "REEDS_SHEPP")
    poses, _ = hybrid(Costmap(grid, CAR), Pose(1.0, 1.0, 2.0), Pose(11.0, 11.0, -2.0), vehicle, Deadline(60))
    assert not collides(grid, poses, CAR)


def test_car_turns_round_in_reverse_where_there_is_no_room_to_turn() -> None:
    cells = np.zeros((24, 80), np.int8)
    grid = type(walled())(cells, 0.1, 0.0, 0.0)
    vehicle = Vehicle(1.5, "REEDS_SHEPP")
    poses, _ = hybrid(Costmap(grid, CAR), Pose(4.0, 1.2, 0.0), Pose(4.0, 1.2, math.pi), vehicle, Deadline(60))
    assert (poses[:, 3] == -1).any()
    assert not collides(grid, poses, CAR)


def test_ends_are_tested_with_the_footprint() -> None:
    costmap = Costmap(walled(), CAR)
    with pytest.raises(NoPath) as raised:  # its front is in the wall, its inscribed circle is not
        hybrid(costmap, Pose(4.7, 2.0, 0.0), Pose(8.0, 2.0, 0.0), Vehicle(), Deadline(10))
    assert raised.value.reason is Reason.START_OCCUPIED
    with pytest.raises(NoPath) as raised:
        hybrid(costmap, Pose(2.0, 2.0, 0.0), Pose(5.4, 2.0, math.pi), Vehicle(), Deadline(10))
    assert raised.value.reason is Reason.GOAL_OCCUPIED


def test_goal_that_cannot_be_reached_has_no_path() -> None:
    with pytest.raises(NoPath) as raised:
        hybrid(Costmap(walled(gap=0), ROBOT), Pose(2, 2, 0), Pose(8, 2, 0), Vehicle(), Deadline(10))
    assert raised.value.reason is Reason.NO_VALID_PATH


def test_search_that_was_stopped_reports_the_time() -> None:
    deadline = Deadline(5)
    deadline.stop()
    with pytest.raises(NoPath) as raised:
        hybrid(Costmap(walled(300), ROBOT), Pose(2, 2, 0), Pose(28, 2, 0), Vehicle(), deadline)
    assert raised.value.reason is Reason.TIMEOUT
