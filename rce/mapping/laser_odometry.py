"""Laser odometry: each scan is matched with what the laser saw on the last metres of the way."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.matching import local_map
from rce.mapping.matching.local_map import LocalMap
from rce.mapping.matching.scan_matching import Match
from rce.mapping.motion import Motion
from rce.mapping.pose_graph.graph import DRIFT
from rce.mapping.scans import Scan
from rce.mapping.state import Reader, State, optional, pack


@dataclass(frozen=True, slots=True)
class LaserOdometrySettings:
    """Settings of laser odometry.

    Attributes:
        move: Metres between scans that are kept; those between show hardly anything new.
        turn: Radians between scans that are kept.
    """

    move: float = 0.2
    turn: float = 0.1


SETTINGS = LaserOdometrySettings()


@dataclass(frozen=True, slots=True)
class _KeptScan:
    number: int
    way: float  # metres that the robot had driven then
    pose: Pose
    points: Points  # (n, 2), metres, frame of the poses


class LaserOdometry:
    """Odometry from scans, with or without wheels.

    Its poses drift, but hardly within the 20 m of way that it remembers. Hähnel et al., An Efficient FastSLAM Algorithm
    for Generating Maps of Large-Scale Cyclic Environments from Raw Laser Range Measurements, 2003, put such scan
    matching in front of a particle filter.

    Attributes:
        wheel_pose: Pose by the lengths that the wheels measured along the headings that the laser found. Without wheels
            it is the pose by the laser.
    """

    def __init__(self, max_range: float) -> None:
        """Start at the origin with a laser of this range, metres."""
        self._motion = Motion()
        self._local = LocalMap(self._scans_around, max_range)
        self._kept: deque[_KeptScan] = deque()
        self._count = 0
        self._way = 0.0
        self._considered: Pose | None = None  # pose at which a scan was last considered for keeping
        self.wheel_pose = ORIGIN

    @property
    def pose(self) -> Pose:
        """Pose of the robot at the last scan, frame of the first."""
        return self._motion.pose

    def add(self, scan: Scan, points: Points | None) -> Match | None:
        """Match the next scan.

        Args:
            scan: The scan.
            points: Its points (n, 2), metres, frame of the robot; None if they are too few to be matched.

        Returns:
            The match, or None if the pose comes from the wheels or the last motion alone.
        """
        predictions = self._motion.predict(scan)
        spread, cost = self._motion.spread(scan), self._motion.step_cost
        found = self._local.match(points, predictions, spread, cost) if points is not None else None
        before, predicted = self.pose, predictions[0]
        pose = found.pose if found else predicted
        # The wheels give the length of the step, the laser the turn.
        length = before.to(pose if scan.odometry is None else predicted)
        self.wheel_pose = self.wheel_pose @ length._replace(theta=before.to(pose).theta)
        contradicts = points is not None and found is None and self._local.contains(pose)  # such a scan is not kept
        reliable = found.unambiguous if found else not contradicts
        self._motion.update(scan, pose, reliable, found.covariance if found else None)
        if points is not None and not contradicts:
            self._keep(points)
        return found

    @property
    def count(self) -> int:
        """Number of scans kept so far, including those forgotten since."""
        return self._count

    def local_points(self, since: int = 0) -> Points:
        """Return the points (n, 2) of the remembered scans from number `since` on, metres, frame of the robot.

        A scan that was kept at the current pose is not among them.
        """
        pieces = [kept.points for kept in self._kept if kept.number >= since and kept.pose != self.pose]
        return self.pose.inverse().transform(np.concatenate([np.empty((0, 2)), *pieces]))

    def state(self) -> State:
        """Return the odometry as arrays to save."""
        kept = list(self._kept)
        return {
            "motion": self._motion.state(),
            "local": self._local.state(),
            "numbers": np.array([each.number for each in kept], np.int64),
            "ways": np.array([each.way for each in kept], np.float64),
            "poses": np.array([each.pose for each in kept], np.float64).reshape(-1, 3),
            "points": pack([each.points for each in kept], np.float64),
            "count": np.array(self._count, np.int64),
            "way": np.array(self._way),
            "looked": optional(self._considered),
            "rolled": optional(self.wheel_pose),
        }

    def restore(self, saved: Reader) -> None:
        """Replace the odometry by a saved one.

        Raises:
            InvalidRequest: The saved arrays are not laser odometry.
        """
        self._motion.restore(saved.part("motion"))
        self._count = saved.whole("count", 2**62)
        if saved.has("local"):
            self._local.restore(saved.part("local"), self._count)
        poses = saved.poses("poses")
        points = saved.unpack("points", np.float64)
        numbers = saved.indices("numbers", self._count, len(poses)).tolist()
        ways = saved.array("ways", np.float64, len(poses)).tolist()
        if len(points) != len(poses):
            raise saved.invalid("points", f"are of {len(points)} scans, not {len(poses)}")
        self._kept = deque(_KeptScan(*each) for each in zip(numbers, ways, poses, points, strict=True))
        self._way, self._considered = saved.number("way"), saved.optional("looked")
        self.wheel_pose = saved.optional("rolled") or ORIGIN

    def _keep(self, points: Points) -> None:
        """Keep the scan if no kept scan near by looks the same way; forget scans from too long ago."""
        pose = self.pose
        if self._considered is not None:
            step = self._considered.to(pose)
            if not step.exceeds(SETTINGS.move, SETTINGS.turn):
                return
            self._way += math.hypot(step.x, step.y) + DRIFT.turn_length * abs(step.theta)
        self._considered = pose
        while self._kept and self._kept[0].way < self._way - local_map.SETTINGS.way:
            self._kept.popleft()
        if all(kept.pose.to(pose).exceeds(SETTINGS.move, SETTINGS.turn) for kept in self._kept):
            kept = _KeptScan(self._count, self._way, pose, pose.transform(points).astype(np.float64))
            self._kept.append(kept)
            self._count += 1
            self._local.add(kept.number, kept.points)
        self._local.recentre(pose)

    def _scans_around(self, pose: Pose) -> Iterator[tuple[int, Points, Points]]:
        for kept in self._kept:
            if math.dist(kept.pose[:2], pose[:2]) < local_map.SETTINGS.radius:
                yield kept.number, np.array([kept.pose[:2]]), kept.points
