"""What scans are matched with: the likelihood of hits around walls, and normal distributions of the hits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rce.mapping import kernels, ndt
from rce.mapping.geometry import Points, Pose, picked

SIGMA = 0.1  # metres; reach of the likelihood around walls, see matching.STRIDE
NORMAL_WIDTH = 0.2  # metres; of the cells that hold normal distributions


class Field:
    """Walls within a rectangle of the map frame. Points outside are ignored.

    `likelihood`: (height, width) uint8, 255 on a wall, falling with SIGMA around it.
    `tiles`, `table`: the cells, `ratio` times as wide, that hold normal distributions, see `ndt`.
    """

    def __init__(self, low: tuple[float, float], high: tuple[float, float], resolution: float) -> None:
        """From corner `low` to corner `high`, metres, in cells of `resolution` metres."""
        self.resolution = resolution
        self.ratio = round(NORMAL_WIDTH / resolution)
        coarse = resolution * self.ratio
        self._corner = np.floor(np.array(low) / coarse) * self.ratio  # of cell [0, 0], cells from the map's origin
        width, height = np.ceil((np.array(high) / resolution - self._corner) / self.ratio).astype(int).tolist()
        self.likelihood = np.zeros((height * self.ratio, width * self.ratio), np.uint8)
        rows, columns = -(-height // ndt.TILE), -(-width // ndt.TILE)
        self.table = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
        self.tiles = np.zeros((rows * columns, ndt.TILE, ndt.TILE, ndt.FIELDS), np.float32)

    def to_cells(self, points: Points) -> Points:
        """Points (n, 2) of the map frame, metres, in cells of the arrays; the centre of cell [0, 0] is (0, 0)."""
        return points / self.resolution - (self._corner + 0.5)

    @property
    def bounds(self) -> tuple[Points, Points]:
        """The lowest and the highest x and y (2,), metres, map frame."""
        low = self._corner * self.resolution
        return low, low + np.array(self.likelihood.shape[::-1]) * self.resolution

    def pose_to_cells(self, pose: Pose) -> Pose:
        x, y = self.to_cells(np.array([pose[:2]]))[0].tolist()
        return Pose(x, y, pose.theta)

    def pose_from_cells(self, pose: Pose) -> Pose:
        x, y = ((np.array(pose[:2]) + self._corner + 0.5) * self.resolution).tolist()
        return Pose(x, y, pose.theta)

    def add(self, points: Points) -> None:
        """Enter the points (n, 2), metres, map frame, at which beams ended."""
        hits = np.ascontiguousarray(self.to_cells(points))
        kernels.stamp_hits(self.likelihood, hits, SIGMA / self.resolution)
        ndt.learn(self.tiles, self.table, hits, self.ratio)

    def at(self, points: Points) -> NDArray[np.uint8]:
        """The likelihood (n,) at points (n, 2), metres, map frame; 0 outside."""
        return picked(self.likelihood, self.to_cells(points) + 0.5, 0)

    def pyramid(self, levels: int) -> NDArray[np.uint8]:
        """(levels, height, width): at level h the largest likelihood in the 2^h by 2^h cells from each cell on (Hess
        et al., Real-Time Loop Closure in 2D LIDAR SLAM, 2016, section V-B)."""
        stack = np.zeros((levels, *self.likelihood.shape), np.uint8)
        stack[0] = self.likelihood
        for level in range(1, levels):
            step = 1 << (level - 1)
            below, here = stack[level - 1], stack[level]
            here[:] = below
            np.maximum(here[:, :-step], below[:, step:], out=here[:, :-step])
            rows = here.copy()
            np.maximum(here[:-step], rows[step:], out=here[:-step])
        return stack


def square_around(pose: Pose, half: float, resolution: float) -> Field:
    """An empty field that reaches `half` metres from a pose to each side."""
    return Field((pose.x - half, pose.y - half), (pose.x + half, pose.y + half), resolution)


def thin(points: Points, width: float, most: int) -> Points:
    """At most `most` of the points (n, 2), spread evenly over those that are `width` metres apart from each other."""
    _, first = np.unique(np.floor(points / width).astype(np.int64) @ np.array([1, 1 << 32]), return_index=True)
    kept = np.sort(first)
    if len(kept) > most:
        kept = kept[np.linspace(0, len(kept) - 1, most).astype(np.int64)]
    return np.ascontiguousarray(points[kept])
