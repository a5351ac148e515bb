"""Occupancy grids: the finished grid, and the growing grid that a mapper fills."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Points, round_up_to_blocks, sample_cells
from rce.mapping.matching import kernels
from rce.mapping.state import Reader, State

BLOCK = 256  # cells; the grid grows in whole blocks, so that it is copied seldom
UNKNOWN = -1  # cell that no beam has touched, as in `nav_msgs/OccupancyGrid`


@dataclass(frozen=True, slots=True)
class SensorModel:
    """Inverse sensor model: the change of a cell's log-odds for each beam, in hundredths.

    Attributes:
        hit: Added to the cell in which a beam ended; p(occupied) = 0.77.
        miss: Subtracted from each cell that a beam passed; p(occupied) = 0.38.
        limit: Bound of the sum on both sides, p = 0.993. It is low so that a door that opened or closed shows in the
            map after a few more scans.
    """

    hit: int = 120
    miss: int = 49
    limit: int = 500


SENSOR_MODEL = SensorModel()


@dataclass(frozen=True, slots=True)
class OccupancyGrid:
    """Map as in `nav_msgs/OccupancyGrid`, its axes parallel to those of the map frame.

    Attributes:
        cells: (height, width) int8, row 0 at the lowest y: -1 unknown, else the probability of being occupied in
            percent.
        resolution: Metres per cell.
        x: Outer corner of cell [0, 0], metres, map frame.
        y: Outer corner of cell [0, 0], metres, map frame.
    """

    cells: NDArray[np.int8]
    resolution: float
    x: float
    y: float

    def centres(self, chosen: NDArray[np.bool_]) -> Points:
        """Return the centres (n, 2), metres, map frame, of the cells that are true in `chosen` (height, width)."""
        rows, columns = np.nonzero(chosen)
        centres: Points = (np.stack([columns, rows], axis=1) + 0.5) * self.resolution + np.array([self.x, self.y])
        return centres

    def at(self, points: Points) -> NDArray[np.int8]:
        """Return the cells (n,) at points (n, 2), metres, map frame; unknown outside the grid."""
        return sample_cells(self.cells, (points - (self.x, self.y)) / self.resolution, UNKNOWN)


def _percent_table() -> NDArray[np.int8]:
    """Return the percentage for each value of the log-odds from -limit to limit."""
    limit = SENSOR_MODEL.limit
    log_odds = np.arange(-limit, limit + 1) / 100.0
    percent = np.rint(100.0 / (1.0 + np.exp(-log_odds))).astype(np.int8)
    percent[limit] = UNKNOWN  # log-odds of zero: no beam has touched the cell
    return percent


PERCENT = _percent_table()


class GridMap:
    """Growing grid of occupancy log-odds (Moravec and Elfes, High Resolution Maps from Wide Angle Sonar, 1985).

    Attributes:
        resolution: Metres per cell.
        log_odds: (height, width) int16, hundredths.
    """

    def __init__(self, resolution: float) -> None:
        """Make an empty grid with cells of `resolution` metres."""
        self.resolution = resolution
        self._corner = np.full(2, -BLOCK)  # column and row of cell [0, 0], counted from the map frame's origin
        self.log_odds = np.zeros((2 * BLOCK, 2 * BLOCK), np.int16)
        self._seen = np.zeros((2, 2), np.int64)  # lowest and highest column and row touched, counted like `_corner`

    def insert(self, sensor: Points, ends: Points) -> None:
        """Add the beams from `sensor` (1, 2) to `ends` (n, 2), metres, map frame."""
        self._grow_to_cover(np.concatenate([ends, sensor]))
        hits = np.ascontiguousarray(self._to_cells(ends))
        x, y = self._to_cells(sensor)[0].tolist()
        kernels.trace_rays(self.log_odds, x, y, hits, SENSOR_MODEL.hit, SENSOR_MODEL.miss, SENSOR_MODEL.limit)

    def state(self) -> State:
        """Return the grid as arrays to save."""
        return {"corner": self._corner.copy(), "log_odds": self.log_odds.copy(), "seen": self._seen.copy()}

    def restore(self, saved: Reader) -> None:
        """Replace the grid by a saved one.

        Raises:
            InvalidRequest: The saved arrays are not a grid.
        """
        log_odds = saved.array("log_odds", np.int16, None, None)
        corner = saved.array("corner", np.int64, 2)
        size = np.array(log_odds.shape[::-1])
        if size.min() < 2 or np.abs(log_odds).max() > SENSOR_MODEL.limit:
            raise saved.invalid("log_odds", "is empty or out of range")
        seen = saved.array("seen", np.int64, 2, 2)
        if not (corner <= seen).all() or not (seen < corner + size).all():
            raise saved.invalid("seen", "is outside the grid")
        self.log_odds, self._corner, self._seen = log_odds, corner, seen

    def render(self) -> OccupancyGrid:
        """Return the part of the grid that beams have touched."""
        (left, low), (right, high) = self._seen - self._corner
        cells = PERCENT[self.log_odds[low : high + 1, left : right + 1] + SENSOR_MODEL.limit]
        x, y = (self._seen[0] * self.resolution).tolist()
        return OccupancyGrid(cells, self.resolution, x, y)

    def _to_cells(self, points: Points) -> Points:
        """Convert points (n, 2) from metres, map frame, to cells of the array; the centre of cell [0, 0] is (0, 0)."""
        return points / self.resolution - (self._corner + 0.5)

    def _grow_to_cover(self, points: Points) -> None:
        """Grow by whole blocks until all points (n, 2), metres, are inside with a margin of one cell."""
        cells = np.floor(points / self.resolution).astype(np.int64)
        low, high = cells.min(axis=0), cells.max(axis=0)
        self._seen = np.stack([np.minimum(self._seen[0], low), np.maximum(self._seen[1], high)])
        size = np.array(self.log_odds.shape[::-1])
        before = round_up_to_blocks(self._corner - (low - 1), BLOCK)
        after = round_up_to_blocks(high + 2 - (self._corner + size), BLOCK)
        if before.any() or after.any():
            columns, rows = zip(before.tolist(), after.tolist(), strict=True)
            self.log_odds = np.pad(self.log_odds, (rows, columns))
            self._corner = self._corner - before
