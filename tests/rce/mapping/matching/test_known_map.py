"""Known map, in which a robot is found and tracked."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rce.mapping.geometry import Pose
from rce.mapping.grid import GridMap, OccupancyGrid
from rce.mapping.matching.known_map import KnownMap
from rce.mapping.matching.scan_matching import Window
from tests.support.laser import PLACE, SENSOR, points_at

VIEWS = [
    PLACE,
    Pose(8.0, 5.5, 0.0),
    Pose(8.0, 2.0, 1.0),
    Pose(13.0, 8.0, 2.0),
    Pose(3.0, 8.0, 0.0),
    Pose(1.0, 5.5, 0.0),
]
WINDOW = Window(0.5, math.radians(30))


@pytest.fixture(scope="module")
def grid() -> OccupancyGrid:
    """Map of the apartment, frame of the building."""
    grid = GridMap(0.05)
    for pose in VIEWS:
        for _ in range(3):
            grid.insert(pose.transform(SENSOR), pose.transform(points_at(pose, beams=1440)))
    return grid.render()


@pytest.fixture(scope="module")
def known(grid: OccupancyGrid) -> KnownMap:
    return KnownMap(grid)


def off(found: Pose, truth: Pose) -> tuple[float, float]:
    motion = truth.to(found)
    return math.hypot(motion.x, motion.y), abs(motion.theta)


@pytest.mark.parametrize("pose", [PLACE, Pose(13.0, 8.0, -3.0), Pose(8.2, 2.2, 1.8)], ids=str)
def test_robot_is_found_anywhere(known: KnownMap, pose: Pose) -> None:
    found = known.find(points_at(pose))
    assert found is not None
    distance, turn = off(found.pose, pose)
    assert distance < 0.05
    assert turn < 0.02
    assert -math.pi <= found.pose.theta < math.pi


def test_few_points_are_not_searched(known: KnownMap) -> None:
    assert known.find(points_at(PLACE)[:20]) is None


def test_strange_place_is_not_found(known: KnownMap) -> None:
    angles = np.linspace(0.0, 2 * math.pi, 400)
    assert known.find(6.0 * np.stack([np.cos(angles), np.sin(angles)], axis=1)) is None


def test_robot_is_matched_near_a_prediction(known: KnownMap) -> None:
    shift = Pose(0.3, -0.2, 0.2)
    found = known.match(points_at(PLACE @ shift), [PLACE], WINDOW)
    assert found is not None
    assert off(found.pose, PLACE @ shift)[0] < 0.05


def test_prediction_outside_of_the_map_is_not_matched(known: KnownMap) -> None:
    assert known.match(points_at(PLACE), [Pose(-50.0, 0.0, 0.0)], WINDOW) is None


def test_coarse_cells_leave_no_gaps_in_walls(grid: OccupancyGrid) -> None:
    """Each fourth cell of a fine map, as wide as four."""
    height, width = (length // 4 * 4 for length in grid.cells.shape)
    blocks = grid.cells[:height, :width].reshape(height // 4, 4, width // 4, 4)
    coarse = KnownMap(OccupancyGrid(blocks.max(axis=(1, 3)), 0.2, grid.x, grid.y))
    found = coarse.match(points_at(PLACE), [PLACE], WINDOW)
    assert found is not None
    assert off(found.pose, PLACE)[0] < 0.15


def test_map_without_walls_has_no_place() -> None:
    empty = KnownMap(OccupancyGrid(np.zeros((40, 40), np.int8), 0.05, 0.0, 0.0))
    assert empty.find(points_at(PLACE)) is None
