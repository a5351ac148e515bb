"""Occupancy grids: the finished one, and the one that a mapper fills."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping import kernels
from rce.mapping.geometry import Points, Pose

HIT, MISS = 85, -40  # log-odds in hundredths: p = 0.70 where a beam ended, 0.40 where it passed
LIMIT = 500  # p = 0.993; so a door that opened or closed shows after a few more scans
BLOCK = 256  # cells by which the grid grows at least
UNKNOWN = -1


@dataclass(frozen=True, slots=True)
class OccupancyGrid:
    """A map as in `nav_msgs/OccupancyGrid`, its axes along those of the map frame.

    `cells`: (height, width) int8, row 0 at the lowest y: -1 unknown, else the probability of being occupied in percent.
    `resolution`: metres per cell. `x`, `y`: the outer corner of cell [0, 0], metres, map frame.
    """

    cells: NDArray[np.int8]
    resolution: float
    x: float
    y: float


def _percent_of_log_odds() -> NDArray[np.int8]:
    log_odds = np.arange(-LIMIT, LIMIT + 1) / 100.0
    percent = np.rint(100.0 / (1.0 + np.exp(-log_odds))).astype(np.int8)
    percent[LIMIT] = UNKNOWN  # zero is what was never seen
    return percent


PERCENT = _percent_of_log_odds()


class GridMap:
    """A grid that grows: log-odds of occupancy (Moravec and Elfes, High Resolution Maps from Wide Angle Sonar, 1985)
    and, for scan matching, the likelihood of hits around the walls, both of the same shape.

    `log_odds`: (height, width) int16, hundredths. `likelihood`: (height, width) uint8, 255 on a wall.
    `sigma`: how far the likelihood reaches (standard deviation, metres).
    """

    def __init__(self, resolution: float, sigma: float) -> None:
        self.resolution = resolution
        self._sigma = sigma / resolution
        self._margin = math.ceil(2.5 * self._sigma) + 1
        self._column, self._row = -BLOCK // 2, -BLOCK // 2  # of cell [0, 0], where the map frame has its own at (0, 0)
        self.log_odds = np.zeros((BLOCK, BLOCK), np.int16)
        self.likelihood = np.zeros((BLOCK, BLOCK), np.uint8)
        self._seen = np.array(
            [[0, 0], [0, 0]]
        )  # lowest and highest column, row that were touched, from the map frame's

    def to_cells(self, points: Points) -> Points:
        """Points (n, 2) of the map frame, metres, in cells of the arrays; the centre of cell [0, 0] is (0, 0)."""
        return points / self.resolution - (self._column + 0.5, self._row + 0.5)

    def pose_to_cells(self, pose: Pose) -> Pose:
        x, y = self.to_cells(np.array([pose[:2]]))[0].tolist()
        return Pose(x, y, pose.theta)

    def pose_from_cells(self, pose: Pose) -> Pose:
        return Pose(
            (pose.x + self._column + 0.5) * self.resolution, (pose.y + self._row + 0.5) * self.resolution, pose.theta
        )

    def insert(self, pose: Pose, points: Points) -> None:
        """Enter the points (n, 2) that a sensor at `pose` measured, given in its frame."""
        ends = np.ascontiguousarray(np.vstack([pose.transform(points), pose[:2]]))
        self._cover(ends)
        cells = self.to_cells(ends)
        hits, (x, y) = cells[:-1], cells[-1].tolist()
        kernels.trace_rays(self.log_odds, x, y, hits, HIT, -MISS, LIMIT)
        kernels.stamp_hits(self.likelihood, hits, self._sigma)

    def render(self) -> OccupancyGrid:
        """The part of the grid that was ever seen."""
        (left, low), (right, high) = self._seen - (self._column, self._row)
        cells = PERCENT[self.log_odds[low : high + 1, left : right + 1] + LIMIT]
        x, y = (self._seen[0] * self.resolution).tolist()
        return OccupancyGrid(cells, self.resolution, x, y)

    def _cover(self, points: Points) -> None:
        """Grow, by whole blocks, until all points (n, 2), metres, and what is stamped around them are inside."""
        cells = np.floor(points / self.resolution).astype(np.int64)
        low, high = cells.min(axis=0), cells.max(axis=0)
        self._seen = np.stack([np.minimum(self._seen[0], low), np.maximum(self._seen[1], high)])
        height, width = self.log_odds.shape
        origin = np.array([self._column, self._row])
        before = _blocks(origin - (low - self._margin))
        after = _blocks(high + self._margin + 1 - (origin + (width, height)))
        if not (before.any() or after.any()):
            return
        widths = ((before[1], after[1]), (before[0], after[0]))
        self.log_odds = np.pad(self.log_odds, widths)
        self.likelihood = np.pad(self.likelihood, widths)
        self._column, self._row = (origin - before).tolist()


def _blocks(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cells to add in whole blocks, none where nothing is missing."""
    return np.maximum(-(-cells // BLOCK), 0) * BLOCK
