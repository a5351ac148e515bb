"""Maps of the particles, which share the tiles that they have in common."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Points, round_up_to_blocks
from rce.mapping.matching import ndt
from rce.mapping.particles import kernels
from rce.mapping.state import Reader, State

WIDTH = 0.2  # metres; width of a cell of normal distributions
RATIO = 4  # fine cells, the unit of the kernels, along a cell
UNIT = WIDTH / RATIO  # metres; width of a fine cell
SIDE = WIDTH * ndt.TILE  # metres; width of a tile
BLOCK = 8  # tiles by which the tables grow
FIRST_TILES = 256  # tiles allocated at first


class TileMaps:
    """Maps of normal distributions, one for each particle, made of shared tiles (copy on write).

    A tile is copied only when one of several maps that have it learns something new there. After resampling, maps
    differ in little, and so they cost little.

    Attributes:
        tables: (count, rows, columns) int32, index of the tile at each place of each map, -1 for none.
        tiles: (n, TILE, TILE, FIELDS) float32, see `ndt`. Their unit is UNIT metres.
    """

    def __init__(self, count: int) -> None:
        """Make `count` empty maps."""
        self.tables = np.full((count, 2 * BLOCK, 2 * BLOCK), -1, np.int32)
        self.tiles = np.zeros((FIRST_TILES, ndt.TILE, ndt.TILE, ndt.FIELDS), np.float32)
        self._users = np.zeros(FIRST_TILES, np.int32)  # number of maps that have a tile
        self._corner = np.full(2, -BLOCK)  # column and row of table entry [0, 0], counted from the map frame's origin

    @property
    def used(self) -> int:
        """Number of tiles in use."""
        return int(np.count_nonzero(self._users))

    def to_cells(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert poses (n, 3) from metres, map frame, to fine cells of the kernels."""
        moved = poses.copy()
        moved[:, :2] = poses[:, :2] / UNIT - (self._corner * ndt.TILE * RATIO + 0.5)
        return moved

    def from_cells(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert poses (n, 3) from fine cells of the kernels to metres, map frame."""
        moved = poses.copy()
        moved[:, :2] = (poses[:, :2] + (self._corner * ndt.TILE * RATIO + 0.5)) * UNIT
        return moved

    def grow_to_cover(self, poses: NDArray[np.float64], reach: float) -> None:
        """Grow the tables until everything within `reach` metres of the poses (n, 3) is inside."""
        low = np.floor((poses[:, :2].min(axis=0) - reach) / SIDE).astype(np.int64)
        high = np.floor((poses[:, :2].max(axis=0) + reach) / SIDE).astype(np.int64)
        size = np.array(self.tables.shape[:0:-1])
        before = round_up_to_blocks(self._corner - low, BLOCK)
        after = round_up_to_blocks(high + 1 - (self._corner + size), BLOCK)
        if before.any() or after.any():
            columns, rows = zip(before.tolist(), after.tolist(), strict=True)
            self.tables = np.pad(self.tables, ((0, 0), rows, columns), constant_values=-1)
            self._corner = self._corner - before

    def unshare(self, poses: NDArray[np.float64], points: Points) -> None:
        """Give each map its own tiles where the points (n, 2), metres, frame of the robot, lie from its pose."""
        cells, scaled = self.to_cells(poses), np.ascontiguousarray(points / UNIT)
        while not kernels.unshare(self.tiles, self.tables, self._users, cells, scaled, RATIO):
            more = max(FIRST_TILES, len(self.tiles) // 2)
            self.tiles = np.concatenate([self.tiles, np.zeros((more, *self.tiles.shape[1:]), np.float32)])
            self._users = np.concatenate([self._users, np.zeros(more, np.int32)])

    def learner(self, poses: NDArray[np.float64], points: Points) -> Callable[[int, int], None]:
        """Return a function that adds points to maps `begin` to `end`, in any number of threads.

        Args:
            poses: (count, 3) pose of the robot in each map, metres and radians, map frame.
            points: (n, 2), metres, frame of the robot.
        """
        self.grow_to_cover(poses, reach_of(points))
        self.unshare(poses, points)
        cells, scaled = self.to_cells(poses), np.ascontiguousarray(points / UNIT)
        return lambda begin, end: kernels.learn(self.tiles, self.tables, cells, scaled, RATIO, begin, end)

    def state(self) -> State:
        """Return the maps as arrays to save."""
        return {"tables": self.tables.copy(), "tiles": self.tiles.copy(), "corner": self._corner.copy()}

    def restore(self, saved: Reader) -> None:
        """Replace the maps by saved ones.

        Raises:
            InvalidRequest: The saved arrays are not maps of as many particles.
        """
        tiles = saved.array("tiles", np.float32, None, ndt.TILE, ndt.TILE, ndt.FIELDS)
        tables = saved.array("tables", np.int32, len(self.tables), None, None)
        if not len(tiles) or not tables.size or not -1 <= tables.min() <= tables.max() < len(tiles):
            raise saved.invalid("tables", "refers to tiles that do not exist")
        self.tiles, self.tables, self._corner = tiles, tables, saved.array("corner", np.int64, 2)
        self._count_users()

    def resample(self, parents: NDArray[np.int64]) -> None:
        """Replace each map i by the map `parents[i]`."""
        self.tables = np.ascontiguousarray(self.tables[parents])
        self._count_users()

    def _count_users(self) -> None:
        self._users = np.bincount(self.tables[self.tables >= 0], minlength=len(self.tiles)).astype(np.int32)


def reach_of(points: Points) -> float:
    """Return the metres from the robot to the farthest of the points (n, 2), with a margin of one tile."""
    return SIDE + math.sqrt(float((points * points).sum(axis=1).max(initial=0.0)))
