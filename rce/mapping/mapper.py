"""What mappers have in common: scans in, poses and an occupancy grid out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Pose
from rce.mapping.grid import OccupancyGrid
from rce.mapping.scans import Scan

UNCERTAIN = np.diag([1.0, 1.0, 0.5])  # covariance of a pose that was not matched; square metres and radians
FEWEST_POINTS = 10  # with fewer, nothing can be said about the pose


@dataclass(frozen=True, slots=True)
class Estimate:
    """What a mapper says about a scan: `pose` in the map frame, `covariance` (3, 3) of x, y, theta, and whether the
    pose comes from a match with the map (else from odometry or the last motion alone). `taken` is False for a scan that
    came too late: it is not part of the map and has no row in the trajectory."""

    stamp: float
    pose: Pose
    covariance: NDArray[np.float64]
    matched: bool
    taken: bool = True


class Mapper(Protocol):
    """What every mapper does. One that optimises may change past poses: read `trajectory` when it is needed."""

    def add(self, scan: Scan) -> Estimate:
        """Take the next scan. One that is not newer than those before is not used, only answered."""

    def grid(self) -> OccupancyGrid:
        """The map as it is now."""

    def trajectory(self) -> NDArray[np.float64]:
        """(n, 4) stamp, x, y, theta of every scan taken so far, map frame."""


@dataclass(frozen=True, slots=True)
class MapperSettings:
    """`resolution` of the grid, metres per cell; `max_range`: beams longer than this are not used, metres.

    For mappers with particles, their number, the seed of their random numbers, and over how many cores they are spread
    (0 for all; the result is the same for any number of them).
    """

    resolution: float = 0.05
    max_range: float = 30.0
    particles: int = 30
    seed: int = 0
    cores: int = 0
