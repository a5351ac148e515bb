"""Mappers: scans in, poses and an occupancy grid out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.grid import GridMap, OccupancyGrid
from rce.mapping.matching import Match, Window, match
from rce.mapping.scans import Scan

SIGMA = 0.1  # metres; reach of the likelihood around walls, see matching.STRIDE
NEAR, FAR = Window(0.5, math.radians(30)), Window(1.5, math.radians(60))
DOUBT = 0.65  # a score under this makes the search go far
UNCERTAIN = np.diag([1.0, 1.0, 0.5])  # covariance of a pose that was not matched; square metres and radians
RESET = 10.0  # metres; if odometry moves this far between two scans, it was set anew
STEADY = 0.5  # seconds for which a robot may be supposed to go on as it did
FEWEST_POINTS = 10  # with fewer, nothing can be said about the pose


@dataclass(frozen=True, slots=True)
class Estimate:
    """What a mapper says about a scan: `pose` in the map frame, `covariance` (3, 3) of x, y, theta, and whether the
    pose comes from a match with the map (else from odometry or the last motion alone)."""

    stamp: float
    pose: Pose
    covariance: NDArray[np.float64]
    matched: bool


class Mapper(Protocol):
    """What every mapper does. One that optimises may change past poses: read `trajectory` when it is needed."""

    def add(self, scan: Scan) -> Estimate:
        """Take the next scan, in order of time."""

    def grid(self) -> OccupancyGrid:
        """The map as it is now."""

    def trajectory(self) -> NDArray[np.float64]:
        """(n, 4) stamp, x, y, theta of every scan taken so far, map frame."""


@dataclass(frozen=True, slots=True)
class MapperSettings:
    """`resolution` of the grid, metres per cell; `max_range`: beams longer than this are not used; `move`, `turn`: a
    scan enters the map when the robot has moved or turned by so much since the last one that did."""

    resolution: float = 0.05
    max_range: float = 30.0
    move: float = 0.2
    turn: float = 0.1


class ScanMatcher:
    """A mapper that matches each scan against the whole map so far and never changes a past pose.

    Two predictions are tried, the motion by odometry and the last motion repeated, since wheels slip and odometry comes
    late. The first scan is at the origin of the map frame.
    """

    def __init__(self, settings: MapperSettings | None = None) -> None:
        self.settings = settings or MapperSettings()
        self._map = GridMap(self.settings.resolution, SIGMA)
        self._poses: list[tuple[float, float, float, float]] = []
        self._pose = ORIGIN
        self._motion = ORIGIN  # from the scan before the last to the last
        self._wheels: tuple[Pose, Pose] | None = None  # last odometry, and the pose of the robot then
        self._entered: Pose | None = None  # where the robot was when the last scan entered the map

    def add(self, scan: Scan) -> Estimate:
        points = scan.points(self.settings.max_range)
        predictions = self._predict(scan)
        found = self._match(points, predictions) if self._entered is not None and len(points) >= FEWEST_POINTS else None
        pose = found.pose if found else predictions[0]
        if len(points) >= FEWEST_POINTS:
            self._enter(pose, points)
        self._motion = self._pose.to(pose) if self._poses else ORIGIN
        self._pose = pose
        if scan.odometry is not None:
            self._wheels = scan.odometry, pose
        self._poses.append((scan.stamp, *pose))
        return Estimate(scan.stamp, pose, found.covariance if found else UNCERTAIN, found is not None)

    def grid(self) -> OccupancyGrid:
        return self._map.render()

    def trajectory(self) -> NDArray[np.float64]:
        return np.array(self._poses, np.float64).reshape(-1, 4)

    def _predict(self, scan: Scan) -> list[Pose]:
        """Where the robot may be now, the most trusted first."""
        if not self._poses:
            return [ORIGIN]
        repeated = self._pose @ self._motion
        if scan.odometry is None or self._wheels is None:
            return [repeated]
        odometry, pose = self._wheels
        motion = odometry.to(scan.odometry)
        plausible = math.hypot(motion.x, motion.y) < RESET  # False for NaN
        if not plausible:
            return [repeated]
        steady = scan.stamp - self._poses[-1][0] < STEADY
        return [pose @ motion, repeated] if steady else [pose @ motion]

    def _match(self, points: NDArray[np.float64], predictions: list[Pose]) -> Match:
        found = match(self._map, points, predictions, NEAR)
        if found.score >= DOUBT:
            return found
        far = match(self._map, points, predictions, FAR)
        return max(found, far, key=lambda candidate: candidate.score)

    def _enter(self, pose: Pose, points: NDArray[np.float64]) -> None:
        if self._entered is None or self._entered.to(pose).moved(self.settings.move, self.settings.turn):
            self._map.insert(pose, points)
            self._entered = pose
