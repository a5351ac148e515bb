"""Interface of all mappers: scans in, poses and an occupancy grid out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Pose
from rce.mapping.grid import OccupancyGrid
from rce.mapping.scans import Scan

UNMATCHED_COVARIANCE = np.diag([1.0, 1.0, 0.5])  # of a pose that was not matched; square metres and radians
MIN_POINTS = 10  # of a scan; fewer do not determine a pose


@dataclass(frozen=True, slots=True)
class Estimate:
    """Answer of a mapper to a scan.

    Attributes:
        stamp: Stamp of the scan, seconds.
        pose: Pose of the robot in the map frame.
        covariance: (3, 3) of x, y, theta in square metres and radians.
        matched: Whether the pose comes from a match with the map, and not from odometry or the last motion alone.
        accepted: False for a scan that came too late: it is not part of the map and has no row in the trajectory.
    """

    stamp: float
    pose: Pose
    covariance: NDArray[np.float64]
    matched: bool
    accepted: bool = True


class Mapper(Protocol):
    """Interface of a mapper. A mapper that optimises may change past poses: read `trajectory` when it is needed."""

    def add(self, scan: Scan) -> Estimate:
        """Map the next scan. One that is not newer than those before is answered but not mapped."""

    def grid(self) -> OccupancyGrid:
        """Return the current map."""

    def trajectory(self) -> NDArray[np.float64]:
        """Return (n, 4) stamp, x, y, theta of every accepted scan, map frame."""


@dataclass(frozen=True, slots=True)
class MapperSettings:
    """Settings of a mapper.

    Attributes:
        resolution: Metres per cell of the grid.
        max_range: Metres; longer beams are not used.
        particles: Number of particles, for mappers that have any.
        seed: Seed of the random numbers of such a mapper.
        cores: Cores over which the particles are spread, 0 for all. The result does not depend on it.
    """

    resolution: float = 0.05
    max_range: float = 30.0
    particles: int = 30
    seed: int = 0
    cores: int = 0
