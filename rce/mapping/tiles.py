"""The maps of many particles, which share what they have in common."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rce.mapping import ndt, particle_kernels
from rce.mapping.geometry import Points
from rce.mapping.state import Reader, State

WIDTH = 0.2  # metres; of a cell
RATIO = 4  # fine cells, the unit of the kernels, in it
UNIT = WIDTH / RATIO
SIDE = WIDTH * ndt.TILE  # metres; of a tile
BLOCK = 8  # tiles by which the tables grow
FIRST = 256  # tiles


class TileMaps:
    """`count` maps of normal distributions, made of tiles that are copied only when one of several maps that have a
    tile learns something new there. After resampling, maps differ in little, and so they cost little.

    `tables`: (count, rows, columns) int32, `tiles`: (n, TILE, TILE, FIELDS) float32; see `ndt`. Their unit is UNIT
    metres.
    """

    def __init__(self, count: int) -> None:
        self.tables = np.full((count, 2 * BLOCK, 2 * BLOCK), -1, np.int32)
        self.tiles = np.zeros((FIRST, ndt.TILE, ndt.TILE, ndt.FIELDS), np.float32)
        self._users = np.zeros(FIRST, np.int32)  # how many maps have a tile
        self._corner = np.full(2, -BLOCK)  # column and row of table entry [0, 0], counted from the map frame's origin

    @property
    def used(self) -> int:
        """How many tiles are in use."""
        return int(np.count_nonzero(self._users))

    def to_cells(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Poses (n, 3) in metres, map frame, in the unit and origin of the kernels."""
        moved = poses.copy()
        moved[:, :2] = poses[:, :2] / UNIT - (self._corner * ndt.TILE * RATIO + 0.5)
        return moved

    def from_cells(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        moved = poses.copy()
        moved[:, :2] = (poses[:, :2] + (self._corner * ndt.TILE * RATIO + 0.5)) * UNIT
        return moved

    def cover(self, poses: NDArray[np.float64], reach: float) -> None:
        """Let the tables grow until everything within `reach` metres of the poses (n, 3) is in them."""
        low = np.floor((poses[:, :2].min(axis=0) - reach) / SIDE).astype(np.int64)
        high = np.floor((poses[:, :2].max(axis=0) + reach) / SIDE).astype(np.int64)
        size = np.array(self.tables.shape[:0:-1])
        before = _blocks(self._corner - low)
        after = _blocks(high + 1 - (self._corner + size))
        if before.any() or after.any():
            columns, rows = zip(before.tolist(), after.tolist(), strict=True)
            self.tables = np.pad(self.tables, ((0, 0), rows, columns), constant_values=-1)
            self._corner = self._corner - before

    def claim(self, poses: NDArray[np.float64], points: Points) -> None:
        """Give each map tiles of its own where the points (n, 2), metres, frame of the robot, lie from its pose."""
        cells, scaled = self.to_cells(poses), np.ascontiguousarray(points / UNIT)
        while not particle_kernels.claim(self.tiles, self.tables, self._users, cells, scaled, RATIO):
            more = max(FIRST, len(self.tiles) // 2)
            self.tiles = np.concatenate([self.tiles, np.zeros((more, *self.tiles.shape[1:]), np.float32)])
            self._users = np.concatenate([self._users, np.zeros(more, np.int32)])

    def state(self) -> State:
        return {"tables": self.tables.copy(), "tiles": self.tiles.copy(), "corner": self._corner.copy()}

    def restore(self, saved: Reader) -> None:
        tiles = saved.array("tiles", np.float32, None, ndt.TILE, ndt.TILE, ndt.FIELDS)
        tables = saved.array("tables", np.int32, len(self.tables), None, None)
        if not len(tiles) or not tables.size or not -1 <= tables.min() <= tables.max() < len(tiles):
            raise saved.wrong("tables", "names tiles that are not there")
        self.tiles, self.tables, self._corner = tiles, tables, saved.array("corner", np.int64, 2)
        self._count_users()

    def resample(self, parents: NDArray[np.int64]) -> None:
        """Replace map i by that of `parents[i]`."""
        self.tables = np.ascontiguousarray(self.tables[parents])
        self._count_users()

    def _count_users(self) -> None:
        self._users = np.bincount(self.tables[self.tables >= 0], minlength=len(self.tiles)).astype(np.int32)


def _blocks(missing: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.maximum(np.ceil(missing / BLOCK).astype(np.int64), 0) * BLOCK


def reach_of(points: Points) -> float:
    """Metres from the robot to the farthest of the points (n, 2), and the side of a tile more."""
    return SIDE + math.sqrt(float((points * points).sum(axis=1).max(initial=0.0)))
