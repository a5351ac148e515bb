"""One sweep of a laser: the record that recordings, the simulation and the ROS node produce and mappers consume."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Points, Pose


@dataclass(frozen=True, slots=True)
class Scan:
    """One sweep of a planar laser, with the fields of `sensor_msgs/LaserScan`.

    Attributes:
        stamp: Seconds.
        ranges: (n,) float32, metres. NaN, infinity, values that are not positive and values of `range_max` or more mean
            that nothing was measured.
        angle_min: Radians; beam i points to `angle_min + i * angle_increment` in the frame of the robot.
        angle_increment: Radians between beams.
        range_max: Metres.
        odometry: Pose of the robot by its wheels at `stamp`, in a frame of its own that drifts; None without odometry.
    """

    stamp: float
    ranges: NDArray[np.float32]
    angle_min: float
    angle_increment: float
    range_max: float
    odometry: Pose | None = None

    def points(self, limit: float) -> Points:
        """Return the ends (m, 2) of the beams that measured less than `limit` metres, frame of the robot."""
        if not math.isfinite(self.angle_min + self.angle_increment):
            return np.empty((0, 2))
        bound = min(limit, self.range_max)
        with np.errstate(invalid="ignore"):
            good = (self.ranges > 0) & (self.ranges < bound)  # False for NaN
        directions = beam_directions(len(self.ranges), self.angle_min, self.angle_increment)
        return directions[good] * self.ranges[good, None].astype(np.float64)


@lru_cache(maxsize=8)
def beam_directions(count: int, angle_min: float, angle_increment: float) -> Points:
    """Return unit vectors (count, 2) of the beams in the frame of the robot."""
    angles = angle_min + angle_increment * np.arange(count)
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)
