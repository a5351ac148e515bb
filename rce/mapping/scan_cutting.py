"""Scans for mappers in the plane, cut from the clouds of lidars that measure in three dimensions."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rce.mapping.clouds import Sweep
from rce.mapping.scans import Scan


@dataclass(frozen=True, slots=True)
class Band:
    """Points that become a part of the scan.

    Attributes:
        low: Metres above the lidar, or below it if negative.
        high: Likewise.
        beams: Beams of the scan, all around.
        nearest: Metres; what is nearer belongs to the robot.
        furthest: Metres.
    """

    low: float = -0.3
    high: float = 0.3
    beams: int = 720
    nearest: float = 0.3
    furthest: float = 80.0


BAND = Band()


def cut_scan(sweep: Sweep, band: Band = BAND) -> Scan:
    """Return the scan of the nearest points of a sweep in a band of heights: each beam has one or infinity.

    The z axis of the lidar is up; beam 0 points backwards.
    """
    x, y, z = sweep.points.T
    ranges = np.hypot(x, y)
    inside = (z >= band.low) & (z <= band.high) & (ranges >= band.nearest) & (ranges < band.furthest)
    step = 2 * math.pi / band.beams
    beams = np.floor((np.arctan2(y[inside], x[inside]) + math.pi) / step + 0.5).astype(np.int64) % band.beams
    nearest = np.full(band.beams, np.inf, np.float32)
    np.minimum.at(nearest, beams, ranges[inside])
    return Scan(sweep.stamp, nearest, -math.pi, step, band.furthest)
