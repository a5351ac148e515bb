"""Local representation of walls for scan matching: a likelihood field and normal distributions of the same hits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Points, Pose, sample_cells
from rce.mapping.matching import kernels, ndt


@dataclass(frozen=True, slots=True)
class FieldSettings:
    """Settings of a field.

    Attributes:
        sigma: Metres; standard deviation of the likelihood around walls. It equals the stride of the search in
            `scan_matching`, so that the likelihood reaches from one position of the search to the next.
        normal_width: Metres; width of the cells that hold normal distributions.
    """

    sigma: float = 0.1
    normal_width: float = 0.2


SETTINGS = FieldSettings()


class Field:
    """Walls within a rectangle of the map frame. Points outside are ignored.

    The likelihood field is that of Thrun, Burgard and Fox, Probabilistic Robotics, 2005, section 6.4; see
    `kernels.stamp_hits`.

    Attributes:
        resolution: Metres per cell of the likelihood.
        ratio: Width of the cells that hold normal distributions, in cells of the likelihood.
        likelihood: (height, width) uint8, 255 on a wall, falling with the distance from it.
        tiles: Normal distributions of the hits, see `ndt`.
        table: Index of the tile at each place, see `ndt`.
    """

    def __init__(self, low: tuple[float, float], high: tuple[float, float], resolution: float) -> None:
        """Make an empty field.

        Args:
            low: Corner of lowest x and y, metres, map frame.
            high: Corner of highest x and y, metres, map frame.
            resolution: Metres per cell.
        """
        self.resolution = resolution
        self.ratio = round(SETTINGS.normal_width / resolution)
        coarse = resolution * self.ratio
        self._corner = np.floor(np.array(low) / coarse) * self.ratio  # of cell [0, 0], cells from the map's origin
        width, height = np.ceil((np.array(high) / resolution - self._corner) / self.ratio).astype(int).tolist()
        self.likelihood = np.zeros((height * self.ratio, width * self.ratio), np.uint8)
        rows, columns = -(-height // ndt.TILE), -(-width // ndt.TILE)
        self.table = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
        self.tiles = np.zeros((rows * columns, ndt.TILE, ndt.TILE, ndt.FIELDS), np.float32)

    def to_cells(self, points: Points) -> Points:
        """Convert points (n, 2) from metres, map frame, to cells of the arrays; the centre of cell [0, 0] is (0, 0)."""
        return points / self.resolution - (self._corner + 0.5)

    @property
    def bounds(self) -> tuple[Points, Points]:
        """Lowest and highest x and y, (2,) each, metres, map frame."""
        low = self._corner * self.resolution
        return low, low + np.array(self.likelihood.shape[::-1]) * self.resolution

    def contains(self, pose: Pose) -> bool:
        """Return whether a pose in the map frame lies inside the field."""
        low, high = self.bounds
        return bool((np.array(pose[:2]) > low).all() and (np.array(pose[:2]) < high).all())

    def pose_to_cells(self, pose: Pose) -> Pose:
        """Convert a pose from metres, map frame, to cells of the arrays."""
        x, y = self.to_cells(np.array([pose[:2]]))[0].tolist()
        return Pose(x, y, pose.theta)

    def pose_from_cells(self, pose: Pose) -> Pose:
        """Convert a pose from cells of the arrays to metres, map frame."""
        x, y = ((np.array(pose[:2]) + self._corner + 0.5) * self.resolution).tolist()
        return Pose(x, y, pose.theta)

    def add(self, points: Points) -> None:
        """Add points (n, 2), metres, map frame, at which beams ended."""
        hits = np.ascontiguousarray(self.to_cells(points))
        kernels.stamp_hits(self.likelihood, hits, SETTINGS.sigma / self.resolution)
        ndt.learn(self.tiles, self.table, hits, self.ratio)

    def at(self, points: Points) -> NDArray[np.uint8]:
        """Return the likelihood (n,) at points (n, 2), metres, map frame; 0 outside."""
        return sample_cells(self.likelihood, self.to_cells(points) + 0.5, 0)

    def pyramid(self, levels: int) -> NDArray[np.uint8]:
        """Return the precomputed grids for branch and bound, (levels, height, width).

        A cell of level h is the maximum of the likelihood over the 2^h by 2^h cells that begin there, an upper bound of
        the score of all translations in that square (Hess et al., Real-Time Loop Closure in 2D LIDAR SLAM, 2016,
        section V-B).
        """
        stack = np.zeros((levels, *self.likelihood.shape), np.uint8)
        stack[0] = self.likelihood
        for level in range(1, levels):
            # The maximum is separable: each level doubles the window of the one below, first by columns, then by rows.
            step = 1 << (level - 1)
            below, here = stack[level - 1], stack[level]
            here[:] = below
            np.maximum(here[:, :-step], below[:, step:], out=here[:, :-step])
            rows = here.copy()
            np.maximum(here[:-step], rows[step:], out=here[:-step])
        return stack


def square_around(pose: Pose, half: float, resolution: float) -> Field:
    """Return an empty field that reaches `half` metres from a pose to each side."""
    return Field((pose.x - half, pose.y - half), (pose.x + half, pose.y + half), resolution)


def every_nth(points: Points, count: int) -> Points:
    """Return `count` points of (n, 2) or up to twice as many, evenly chosen; all if there are fewer."""
    return np.ascontiguousarray(points[:: max(1, len(points) // count)])


def downsample(points: Points, spacing: float, limit: int) -> Points:
    """Return points (n, 2) reduced to one for each square of `spacing` metres, and evenly to at most `limit`."""
    _, first = np.unique(np.floor(points / spacing).astype(np.int64) @ np.array([1, 1 << 32]), return_index=True)
    kept = np.sort(first)
    if len(kept) > limit:
        kept = kept[np.linspace(0, len(kept) - 1, limit).astype(np.int64)]
    return np.ascontiguousarray(points[kept])
