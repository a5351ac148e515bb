from __future__ import annotations

import math

import numpy as np

from rce.mapping.grid import OccupancyGrid
from rce.mapping3d.dense.frontiers import nearest_frontier


def corridor() -> OccupancyGrid:
    """Return a corridor of 1 m x 4 m along x, with walls on three sides; what is beyond x = 4 m is unknown."""
    cells = np.full((30, 100), -1, np.int8)
    cells[5:25, 0:80] = 0
    cells[[4, 25], 0:80] = 100
    cells[4:26, 0] = 100
    return OccupancyGrid(cells, 0.05, 0.0, 0.0)


def test_goal_is_the_open_end_and_looks_out_of_it() -> None:
    goal = nearest_frontier(corridor(), 1.0, 0.75, 0.2)
    assert goal is not None
    assert 3.6 < goal.x < 4.0
    assert 0.4 < goal.y < 1.1
    assert abs(goal.heading) < math.radians(30)


def test_explored_room_has_no_goal() -> None:
    grid = corridor()
    grid.cells[4:26, 79] = 100
    assert nearest_frontier(grid, 1.0, 0.75, 0.2) is None


def test_frontier_behind_a_gap_that_is_too_narrow_is_no_goal() -> None:
    grid = corridor()
    grid.cells[5:25, 50] = 100
    grid.cells[12:16, 50] = 0  # 0.2 m wide
    assert nearest_frontier(grid, 1.0, 0.75, 0.2) is None
    grid.cells[9:20, 50] = 0
    assert nearest_frontier(grid, 1.0, 0.75, 0.2) is not None


def test_nearest_way_wins_not_the_nearest_distance() -> None:
    cells = np.full((60, 60), 0, np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    cells[30, 1:55] = 100  # a wall, open on the right
    cells[20:28, 1:9] = -1  # close to (1, 40), on the other side of the wall
    cells[56:59, 30:40] = -1
    goal = nearest_frontier(OccupancyGrid(cells, 0.05, 0.0, 0.0), 0.4, 1.8, 0.1)
    assert goal is not None
    assert goal.y > 2.0


def test_robot_outside_the_map_has_no_goal() -> None:
    assert nearest_frontier(corridor(), 40.0, 0.75, 0.2) is None
