"""Find the next exploration point at a frontier, the edge between known and unknown space.

Yamauchi, A Frontier-Based Approach for Autonomous Exploration, 1997.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from rce.mapping.grid import UNKNOWN, OccupancyGrid
from rce.mapping.matching.kernels import compiled

MIN_LENGTH = 0.3  # metres of a frontier, less than which is a gap in the data
OCCUPIED = 50  # percent
UNREACHED = -1
REACH = 1.0  # metres around the robot in which its way may begin


class Goal(NamedTuple):
    """Exploration point.

    Attributes:
        x: Metres, frame of the grid.
        y: Metres, frame of the grid.
        heading: Towards the unknown, radians, counter-clockwise from the x axis.
    """

    x: float
    y: float
    heading: float


def nearest_frontier(grid: OccupancyGrid, x: float, y: float, radius: float) -> Goal | None:
    """Return the place at the frontier with the shortest way from (x, y), or None if none can be reached.

    Args:
        grid: The map.
        x: Of the robot, metres, frame of the grid.
        y: Of the robot, metres, frame of the grid.
        radius: Distance that the robot keeps from obstacles, metres.
    """
    reach = math.ceil(radius / grid.resolution)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    occupied = (grid.cells >= OCCUPIED).astype(np.uint8)
    passable = (grid.cells >= 0) & (cv2.dilate(occupied, disc) == 0)
    start = _nearest(passable, (x - grid.x) / grid.resolution - 0.5, (y - grid.y) / grid.resolution - 0.5)
    if start is None or start[2] * grid.resolution > REACH:
        return None
    ways = np.full(passable.shape, UNREACHED, np.int32)
    spread(passable, ways, start[0], start[1])
    best: tuple[int, Goal] | None = None
    for edge in _frontiers(grid):
        near = (cv2.dilate(edge.astype(np.uint8), disc) > 0) & (ways != UNREACHED)
        if near.any():
            row, column = np.unravel_index(np.where(near, ways, np.iinfo(np.int32).max).argmin(), near.shape)
            way = int(ways[row, column])
            if best is None or way < best[0]:
                best = way, _goal(grid, edge, int(row), int(column))
    return best[1] if best else None


def _frontiers(grid: OccupancyGrid) -> list[NDArray[np.bool_]]:
    """Return a mask for each connected group of free cells beside unknown ones that is long enough."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    unknown = cv2.dilate((grid.cells == UNKNOWN).astype(np.uint8), cross) > 0
    edge = unknown & (grid.cells >= 0) & (grid.cells < OCCUPIED)
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(edge.astype(np.uint8), connectivity=8)
    large = np.flatnonzero(statistics[1:, cv2.CC_STAT_AREA] * grid.resolution >= MIN_LENGTH) + 1
    return [labels == label for label in large]


def _goal(grid: OccupancyGrid, edge: NDArray[np.bool_], row: int, column: int) -> Goal:
    """Return the centre of a cell, with the heading to the nearest part of a frontier, or outwards on it."""
    rows, columns = np.nonzero(edge)
    close = np.hypot(rows - row, columns - column) < 1.0 / grid.resolution
    height, width = float((rows[close] - row).mean()), float((columns[close] - column).mean())
    if math.hypot(height, width) < 1.0:
        height, width = _outwards(grid, row, column)
    x, y = grid.x + (column + 0.5) * grid.resolution, grid.y + (row + 0.5) * grid.resolution
    return Goal(x, y, math.atan2(height, width))


def _outwards(grid: OccupancyGrid, row: int, column: int) -> tuple[float, float]:
    """Return the direction, rows and columns, from a cell to the middle of the unknown cells near it."""
    half = round(0.5 / grid.resolution)
    top, left = max(0, row - half), max(0, column - half)
    rows, columns = np.nonzero(grid.cells[top : row + half + 1, left : column + half + 1] == UNKNOWN)
    if not len(rows):
        return 0.0, 1.0
    return float(rows.mean()) + top - row, float(columns.mean()) + left - column


def _nearest(cells: NDArray[np.bool_], column: float, row: float) -> tuple[int, int, float] | None:
    """Return row and column of the nearest true cell and its distance, cells; None if there is none."""
    rows, columns = np.nonzero(cells)
    if not len(rows):
        return None
    distances = np.hypot(rows - row, columns - column)
    best = int(distances.argmin())
    return int(rows[best]), int(columns[best]), float(distances[best])


@compiled("void(boolean[:,::1], int32[:,::1], int64, int64)")
def spread(passable: NDArray[np.bool_], ways: NDArray[np.int32], row: int, column: int) -> None:
    """Set the length of the way from a cell to each that is passable, in cells and steps along the axes.

    Args:
        passable: (height, width).
        ways: (height, width), all `UNREACHED`, changed in place.
        row: Where ways begin.
        column: Where ways begin.
    """
    height, width = passable.shape
    queue = np.empty((passable.size, 2), np.int32)
    queue[0, 0], queue[0, 1] = row, column
    ways[row, column] = 0
    first, count = 0, 1
    while first < count:
        r, c = queue[first, 0], queue[first, 1]
        first += 1
        for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            below, beside = r + down, c + right
            inside = 0 <= below < height and 0 <= beside < width
            if inside and passable[below, beside] and ways[below, beside] == UNREACHED:
                ways[below, beside] = ways[r, c] + 1
                queue[count, 0], queue[count, 1] = below, beside
                count += 1
