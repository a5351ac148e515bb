"""Finding and following a robot in a map that is there already."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.grid import OccupancyGrid
from rce.mapping.history import History
from rce.mapping.known_map import KnownMap
from rce.mapping.laser_odometry import LaserOdometry
from rce.mapping.mapper import FEWEST_POINTS, UNCERTAIN, Estimate, MapperSettings
from rce.mapping.matching import Match, Window
from rce.mapping.motion import Motion
from rce.mapping.scans import Scan

ANYWHERE = np.diag([1e6, 1e6, math.pi**2])  # covariance of a pose that says nothing
NEAR, FAR = Window(0.5, math.radians(30)), Window(1.5, math.radians(60))
GOOD = 0.6  # score from which on a scan belongs to the map
BAD = 0.45  # mean score of the last scans under which the robot is lost
SCANS = 20  # the last ones that are asked
FIRST_WAY, LAST_WAY = 0.5, 4.0  # metres between two searches of the whole map: more after each that fails


class Localiser:
    """Follows the robot by matching each scan with the map; where it does not know where the robot is, it collects what
    the laser sees on a few metres of way and searches the whole map for it (see `KnownMap.find`).

    It is a `Mapper` whose map does not change. While it is `lost`, scans are answered with `taken=False` and a
    covariance that says nothing. One without an initial pose begins lost.
    """

    def __init__(
        self, grid: OccupancyGrid, initial: Pose | None = None, settings: MapperSettings | None = None
    ) -> None:
        """`initial`: pose of the robot in the map frame, within a metre and 45 degrees; None if it is not known."""
        self.settings = settings or MapperSettings(resolution=grid.resolution)
        self._map = KnownMap(grid)
        self._history = History()
        self._stamp = -math.inf
        self._set(initial)

    @property
    def lost(self) -> bool:
        return self._motion is None

    def relocate(self, pose: Pose | None) -> None:
        """Say where the robot is (within a metre and 45 degrees), or, by None, that it has to be searched for."""
        self._set(pose)

    def add(self, scan: Scan) -> Estimate:
        if not scan.stamp > self._stamp:
            return Estimate(scan.stamp, self._last(), UNCERTAIN, matched=False, taken=False)
        self._stamp = scan.stamp
        points = scan.points(self.settings.max_range)
        usable = points if len(points) >= FEWEST_POINTS else None
        found = self._search(scan, usable) if self._motion is None else self._track(self._motion, scan, usable)
        if self._motion is None:
            return Estimate(scan.stamp, self._last(), ANYWHERE, matched=False, taken=False)
        self._history.append(scan.stamp, 0, self._motion.pose)
        covariance = found.covariance if found else UNCERTAIN
        return Estimate(scan.stamp, self._motion.pose, covariance, found is not None)

    def grid(self) -> OccupancyGrid:
        return self._map.grid

    def trajectory(self) -> NDArray[np.float64]:
        """(n, 4) stamp, x, y, theta of the scans whose pose is known, map frame."""
        return self._history.trajectory(np.zeros((1, 3)))

    def _last(self) -> Pose:
        return self._history.at(math.inf)[1] if len(self._history) else ORIGIN

    def _set(self, pose: Pose | None) -> None:
        self._motion: Motion | None = None if pose is None else Motion(pose)
        self._scores: deque[float] = deque(maxlen=SCANS)
        self._unsure = True  # the first scan at a pose that was said may be some way off
        self._odometry = LaserOdometry(self.settings.max_range)
        self._searched: Pose | None = None  # pose of the laser odometry at the last search
        self._way = FIRST_WAY  # metres to the next one

    def _track(self, motion: Motion, scan: Scan, points: Points | None) -> Match | None:
        """Match the scan with the map around the robot; None if it does not belong there."""
        predictions = motion.predict(scan)
        found = self._map.match(points, predictions, FAR if self._unsure else NEAR) if points is not None else None
        if found is not None:
            self._scores.append(found.score)
            self._unsure = found.score < GOOD
        good = found is not None and found.score >= BAD
        motion.follow(scan, found.pose if found and good else predictions[0])
        if len(self._scores) == SCANS and sum(self._scores) < BAD * SCANS:
            self._set(None)
            return None
        return found if good else None

    def _search(self, scan: Scan, points: Points | None) -> Match | None:
        """Collect what is seen, and search the map for it now and then."""
        self._odometry.add(scan, points)
        pose = self._odometry.pose
        if points is None:
            return None
        if self._searched is not None:
            if not self._searched.to(pose).moved(self._way, math.pi / 2):
                return None
            self._way = min(2 * self._way, LAST_WAY)
        self._searched = pose
        found = self._map.find(np.concatenate([points, self._odometry.seen()]))
        if found is not None:
            self._set(found.pose)
            self._motion = Motion(found.pose)
            self._motion.follow(scan, found.pose)
        return found
