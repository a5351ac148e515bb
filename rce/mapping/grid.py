"""Occupancy grids: the finished one, and the one that a mapper fills."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping import kernels
from rce.mapping.geometry import Points, picked
from rce.mapping.state import Reader, State

HIT, MISS = 120, -49  # log-odds in hundredths: p = 0.77 where a beam ended, 0.38 where it passed
LIMIT = 500  # p = 0.993; so a door that opened or closed shows after a few more scans
BLOCK = 256  # cells by which the grid grows
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

    def at(self, points: Points) -> NDArray[np.int8]:
        """The cells (n,) at points (n, 2), metres, map frame; unknown outside."""
        return picked(self.cells, (points - (self.x, self.y)) / self.resolution, UNKNOWN)


def _percent_of_log_odds() -> NDArray[np.int8]:
    log_odds = np.arange(-LIMIT, LIMIT + 1) / 100.0
    percent = np.rint(100.0 / (1.0 + np.exp(-log_odds))).astype(np.int8)
    percent[LIMIT] = UNKNOWN  # zero is what was never seen
    return percent


PERCENT = _percent_of_log_odds()


class GridMap:
    """A grid that grows: log-odds of occupancy (Moravec and Elfes, High Resolution Maps from Wide Angle Sonar, 1985).

    `log_odds`: (height, width) int16, hundredths.
    """

    def __init__(self, resolution: float) -> None:
        self.resolution = resolution
        self._corner = np.full(2, -BLOCK)  # column and row of cell [0, 0], counted from the map frame's origin
        self.log_odds = np.zeros((2 * BLOCK, 2 * BLOCK), np.int16)
        self._seen = np.zeros((2, 2), np.int64)  # lowest and highest column and row touched, counted like `_corner`

    def insert(self, sensor: Points, ends: Points) -> None:
        """Enter the beams from `sensor` (1, 2) to `ends` (n, 2), metres, map frame."""
        self._cover(np.concatenate([ends, sensor]))
        hits = np.ascontiguousarray(self._to_cells(ends))
        x, y = self._to_cells(sensor)[0].tolist()
        kernels.trace_rays(self.log_odds, x, y, hits, HIT, -MISS, LIMIT)

    def state(self) -> State:
        return {"corner": self._corner.copy(), "log_odds": self.log_odds.copy(), "seen": self._seen.copy()}

    def restore(self, saved: Reader) -> None:
        log_odds = saved.array("log_odds", np.int16, None, None)
        corner = saved.array("corner", np.int64, 2)
        size = np.array(log_odds.shape[::-1])
        if size.min() < 2 or np.abs(log_odds).max() > LIMIT:
            raise saved.wrong("log_odds", "is empty or beyond its limits")
        seen = saved.array("seen", np.int64, 2, 2)
        if not (corner <= seen).all() or not (seen < corner + size).all():
            raise saved.wrong("seen", "is not inside of the grid")
        self.log_odds, self._corner, self._seen = log_odds, corner, seen

    def render(self) -> OccupancyGrid:
        """The part of the grid that was ever seen."""
        (left, low), (right, high) = self._seen - self._corner
        cells = PERCENT[self.log_odds[low : high + 1, left : right + 1] + LIMIT]
        x, y = (self._seen[0] * self.resolution).tolist()
        return OccupancyGrid(cells, self.resolution, x, y)

    def _to_cells(self, points: Points) -> Points:
        """Points (n, 2) of the map frame, metres, in cells of the array; the centre of cell [0, 0] is (0, 0)."""
        return points / self.resolution - (self._corner + 0.5)

    def _cover(self, points: Points) -> None:
        """Grow, by whole blocks, until all points (n, 2), metres, are inside with a cell to spare."""
        cells = np.floor(points / self.resolution).astype(np.int64)
        low, high = cells.min(axis=0), cells.max(axis=0)
        self._seen = np.stack([np.minimum(self._seen[0], low), np.maximum(self._seen[1], high)])
        size = np.array(self.log_odds.shape[::-1])
        before = _whole_blocks(self._corner - (low - 1))
        after = _whole_blocks(high + 2 - (self._corner + size))
        if before.any() or after.any():
            columns, rows = zip(before.tolist(), after.tolist(), strict=True)
            self.log_odds = np.pad(self.log_odds, (rows, columns))
            self._corner = self._corner - before


def _whole_blocks(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """At least as many cells as are missing, in whole blocks; none where the number is negative."""
    return np.maximum(-(-cells // BLOCK), 0) * BLOCK
