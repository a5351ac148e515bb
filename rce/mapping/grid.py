"""Occupancy grids: the finished one, and the one that a mapper fills."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping import kernels, ndt
from rce.mapping.geometry import Points, Pose

HIT, MISS = 120, -49  # log-odds in hundredths: p = 0.77 where a beam ended, 0.38 where it passed
LIMIT = 500  # p = 0.993; so a door that opened or closed shows after a few more scans
BLOCK = 256  # cells by which the grid grows, about
NORMAL_WIDTH = 0.2  # metres; of the cells that hold normal distributions
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
    and what scans are matched with: the likelihood of hits around walls, and normal distributions of the hits.

    `log_odds`: (height, width) int16, hundredths. `likelihood`: (height, width) uint8, 255 on a wall.
    `normals`: (height / ratio, width / ratio, 6) float32, see `ndt`.
    `sigma`: how far the likelihood reaches (standard deviation, metres).
    """

    def __init__(self, resolution: float, sigma: float) -> None:
        self.resolution = resolution
        self.ratio = max(1, round(NORMAL_WIDTH / resolution))
        self._sigma = sigma / resolution
        self._margin = max(math.ceil(2.5 * self._sigma), self.ratio) + 1
        self._block = BLOCK // self.ratio * self.ratio
        self._corner = np.full(2, -self._block)  # column and row of cell [0, 0], counted from the map frame's origin
        side = 2 * self._block
        self.log_odds = np.zeros((side, side), np.int16)
        self.likelihood = np.zeros((side, side), np.uint8)
        self.normals = np.zeros((side // self.ratio, side // self.ratio, ndt.FIELDS), np.float32)
        self._seen = np.zeros((2, 2), np.int64)  # lowest and highest column and row touched, counted like `_corner`

    def to_cells(self, points: Points) -> Points:
        """Points (n, 2) of the map frame, metres, in cells of the arrays; the centre of cell [0, 0] is (0, 0)."""
        return points / self.resolution - (self._corner + 0.5)

    def pose_to_cells(self, pose: Pose) -> Pose:
        x, y = self.to_cells(np.array([pose[:2]]))[0].tolist()
        return Pose(x, y, pose.theta)

    def pose_from_cells(self, pose: Pose) -> Pose:
        x, y = ((np.array(pose[:2]) + self._corner + 0.5) * self.resolution).tolist()
        return Pose(x, y, pose.theta)

    def insert(self, pose: Pose, points: Points) -> None:
        """Enter the points (n, 2) that a sensor at `pose` measured, given in its frame."""
        ends = np.ascontiguousarray(np.vstack([pose.transform(points), pose[:2]]))
        self._cover(ends)
        cells = self.to_cells(ends)
        hits, (x, y) = cells[:-1], cells[-1].tolist()
        kernels.trace_rays(self.log_odds, x, y, hits, HIT, -MISS, LIMIT)
        kernels.stamp_hits(self.likelihood, hits, self._sigma)
        ndt.learn(self.normals, hits, self.ratio)

    def render(self) -> OccupancyGrid:
        """The part of the grid that was ever seen."""
        (left, low), (right, high) = self._seen - self._corner
        cells = PERCENT[self.log_odds[low : high + 1, left : right + 1] + LIMIT]
        x, y = (self._seen[0] * self.resolution).tolist()
        return OccupancyGrid(cells, self.resolution, x, y)

    def _cover(self, points: Points) -> None:
        """Grow, by whole blocks, until all points (n, 2), metres, and what is stamped around them are inside."""
        cells = np.floor(points / self.resolution).astype(np.int64)
        low, high = cells.min(axis=0), cells.max(axis=0)
        self._seen = np.stack([np.minimum(self._seen[0], low), np.maximum(self._seen[1], high)])
        size = np.array(self.log_odds.shape[::-1])
        before = self._whole_blocks(self._corner - (low - self._margin))
        after = self._whole_blocks(high + self._margin + 1 - (self._corner + size))
        if before.any() or after.any():
            columns, rows = zip(before.tolist(), after.tolist(), strict=True)
            self.log_odds = np.pad(self.log_odds, (rows, columns))
            self.likelihood = np.pad(self.likelihood, (rows, columns))
            coarse = [(first // self.ratio, last // self.ratio) for first, last in (rows, columns)]
            self.normals = np.pad(self.normals, (*coarse, (0, 0)))
            self._corner = self._corner - before

    def _whole_blocks(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        """At least as many cells as are missing, in whole blocks; none where the number is negative."""
        return np.maximum(-(-cells // self._block), 0) * self._block
