"""Paths that cover a space."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from rce.bench.planning import building
from rce.errors import InvalidRequest
from rce.mapping.geometry import Pose
from rce.mapping.grid import OccupancyGrid
from rce.planning.costmap import BLOCKED, Costmap
from rce.planning.coverage import Lane, cover, decompose, lanes_of
from rce.planning.failures import NoPath
from rce.planning.search.deadline import Deadline
from tests.support.planning import ROBOT, grid_of, random_map

START = Pose(1.0, 1.0, 0.0)


def cleared(seed: int) -> OccupancyGrid:
    grid = random_map(seed, 120, 0.003)
    grid.cells[:20, :20] = 0
    return grid


@pytest.mark.parametrize("grid", [building(), cleared(1), cleared(2)], ids=["building", "sparse", "sparse again"])
@pytest.mark.parametrize("tool", [0.3, 0.8])
def test_path_is_free_and_covers_99_percent(grid: OccupancyGrid, tool: float) -> None:
    costmap = Costmap(grid, ROBOT)
    start = Pose(1.0, 5.5, 0.0) if grid.x < 0 else START
    found = cover(costmap, start, tool, Deadline(60))
    columns, rows = np.floor((found.poses[:, :2] - costmap.corner) / costmap.resolution).astype(int).T
    assert (costmap.costs[rows, columns] < BLOCKED).all()
    assert np.hypot(*np.diff(found.poses[:, :2], axis=0).T).max() < 2.2 * costmap.resolution  # the start is in a cell
    unvisited = np.full(costmap.costs.shape, 255, np.uint8)
    unvisited[rows, columns] = 0
    distance = cv2.distanceTransform(unvisited, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * costmap.resolution
    reachable = costmap.regions == costmap.regions[costmap.cell(start.x, start.y)]
    share = float((distance[reachable] <= tool / 2 + 1e-6).mean())
    assert share >= 0.99
    assert abs(found.share - share) < 1e-3


def test_obstacle_splits_the_space_into_four_cells() -> None:
    free = grid_of(*["         "] * 3, *["   ###   "] * 3, *["         "] * 3).cells == 0
    cells = decompose(free)
    assert sorted((cell[0].column, cell[-1].column, cell[0].low) for cell in cells) == [
        (0, 2, 0),
        (3, 5, 0),
        (3, 5, 6),
        (6, 8, 0),
    ]


def test_lanes_are_even_and_no_farther_apart_than_the_spacing() -> None:
    cell = [Lane(column, 0, 9) for column in range(10, 30)]
    columns = [lane.column for lane in lanes_of(cell, 6)]
    assert len(columns) == 4
    assert max(np.diff(columns)) <= 6
    assert columns[0] - 10 <= 3
    assert 29 - columns[-1] <= 3


def test_narrow_tool_and_blocked_start_are_refused() -> None:
    costmap = Costmap(cleared(1), ROBOT)
    with pytest.raises(InvalidRequest, match=r"0\.2 m or more"):
        cover(costmap, START, 0.1, Deadline(10))
    with pytest.raises(NoPath):
        cover(costmap, Pose(0.0, 0.0, 0.0), 0.5, Deadline(10))
