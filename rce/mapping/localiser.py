"""Localisation: finding and tracking a robot in a known map."""

from __future__ import annotations

import dataclasses
import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.grid import OccupancyGrid
from rce.mapping.history import History
from rce.mapping.laser_odometry import LaserOdometry
from rce.mapping.mapper import MIN_POINTS, UNMATCHED_COVARIANCE, Estimate, MapperSettings
from rce.mapping.matching.known_map import KnownMap
from rce.mapping.matching.scan_matching import Match, Window
from rce.mapping.motion import Motion
from rce.mapping.scans import Scan

UNKNOWN_COVARIANCE = np.diag([1e6, 1e6, math.pi**2])  # of a robot that may be anywhere


@dataclasses.dataclass(frozen=True, slots=True)
class LocaliserSettings:
    """Settings of the localiser. Scores are mean likelihoods, 0..1.

    Attributes:
        near: Window of the search around a robot that is tracked well.
        far: Window of the search around an initial pose, and after a poor match.
        good_score: Score from which on the robot is tracked well.
        bad_score: Mean score of the last `scans` scans below which the robot is lost, and score of a single scan below
            which its match is not used.
        scans: Number of scans over which the score is averaged.
        first_way: Metres between the first two searches of the whole map.
        last_way: Metres between searches at most; the distance doubles after each search that fails.
        search_turn: Radians; a turn by as much starts a search, too, since the laser sees something else.
    """

    near: Window = dataclasses.field(default_factory=lambda: Window(0.5, math.radians(30)))
    far: Window = dataclasses.field(default_factory=lambda: Window(1.5, math.radians(60)))
    good_score: float = 0.6
    bad_score: float = 0.45
    scans: int = 20
    first_way: float = 0.5
    last_way: float = 4.0
    search_turn: float = math.pi / 2


SETTINGS = LocaliserSettings()


class Localiser:
    """Tracks a robot in a known map, and finds it if it is lost. A `Mapper` whose map does not change.

    Tracking matches each scan with the map. A lost robot collects what the laser sees along a few metres of way and
    searches the whole map for it (see `KnownMap.find`). Meanwhile scans are answered with `accepted=False` and a
    covariance that allows any pose. Without an initial pose the robot begins lost.
    """

    def __init__(
        self, grid: OccupancyGrid, initial: Pose | None = None, settings: MapperSettings | None = None
    ) -> None:
        """Prepare a map.

        Args:
            grid: The map.
            initial: Pose of the robot in the map frame, to within a metre and 45 degrees; None if it is unknown.
            settings: Settings; of these only the range of the laser matters.
        """
        self.settings = settings or MapperSettings(resolution=grid.resolution)
        self._map = KnownMap(grid)
        self._history = History()
        self._stamp = -math.inf
        self._start_from(initial)

    @property
    def lost(self) -> bool:
        """True if the pose of the robot is unknown."""
        return self._motion is None

    def relocate(self, pose: Pose | None) -> None:
        """Set the pose of the robot, to within a metre and 45 degrees, or search for the robot if it is None."""
        self._start_from(pose)

    def add(self, scan: Scan) -> Estimate:
        """Localise the next scan. One that is not newer than those before is answered but not used."""
        if not scan.stamp > self._stamp:
            return Estimate(scan.stamp, self._last_pose(), UNMATCHED_COVARIANCE, matched=False, accepted=False)
        self._stamp = scan.stamp
        points = scan.points(self.settings.max_range)
        usable = points if len(points) >= MIN_POINTS else None
        found = self._search(scan, usable) if self._motion is None else self._track(self._motion, scan, usable)
        if self._motion is None:
            return Estimate(scan.stamp, self._last_pose(), UNKNOWN_COVARIANCE, matched=False, accepted=False)
        self._history.append(scan.stamp, 0, self._motion.pose)
        covariance = found.covariance if found else UNMATCHED_COVARIANCE
        return Estimate(scan.stamp, self._motion.pose, covariance, found is not None)

    def grid(self) -> OccupancyGrid:
        """Return the map."""
        return self._map.grid

    def trajectory(self) -> NDArray[np.float64]:
        """Return (n, 4) stamp, x, y, theta of the scans whose pose is known, map frame."""
        return self._history.trajectory(np.zeros((1, 3)))

    def _last_pose(self) -> Pose:
        return self._history.at(math.inf)[1] if len(self._history) else ORIGIN

    def _start_from(self, pose: Pose | None) -> None:
        self._motion: Motion | None = None if pose is None else Motion(pose)
        self._scores: deque[float] = deque(maxlen=SETTINGS.scans)
        self._doubtful = True  # an initial pose may be some way off: the next scan is searched in the far window
        self._odometry = LaserOdometry(self.settings.max_range)
        self._searched: Pose | None = None  # pose of the laser odometry at the last search
        self._way = SETTINGS.first_way  # metres to the next search

    def _track(self, motion: Motion, scan: Scan, points: Points | None) -> Match | None:
        """Match a scan with the map near the robot; None if it does not fit there."""
        predictions = motion.predict(scan)
        window = SETTINGS.far if self._doubtful else SETTINGS.near
        found = self._map.match(points, predictions, window) if points is not None else None
        if found is not None:
            self._scores.append(found.score)
            self._doubtful = found.score < SETTINGS.good_score
        good = found is not None and found.score >= SETTINGS.bad_score
        if found and good:
            motion.update(scan, found.pose, covariance=found.covariance)
        else:
            motion.update(scan, predictions[0])
        if len(self._scores) == SETTINGS.scans and sum(self._scores) < SETTINGS.bad_score * SETTINGS.scans:
            self._start_from(None)
            return None
        return found if good else None

    def _search(self, scan: Scan, points: Points | None) -> Match | None:
        """Collect a scan of a lost robot, and from time to time search the map for what was collected."""
        self._odometry.add(scan, points)
        pose = self._odometry.pose
        if points is None:
            return None
        if self._searched is not None:
            if not self._searched.to(pose).exceeds(self._way, SETTINGS.search_turn):
                return None
            self._way = min(2 * self._way, SETTINGS.last_way)
        self._searched = pose
        found = self._map.find(np.concatenate([points, self._odometry.local_points()]))
        if found is not None:
            self._start_from(found.pose)
            self._motion = Motion(found.pose)
            self._motion.update(scan, found.pose)
        return found
