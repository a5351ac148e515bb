"""How the robot moves, by its laser: each scan is matched with what was seen on the last metres of the way."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.graph import TURN_LENGTH
from rce.mapping.local_map import AROUND, WAY, LocalMap
from rce.mapping.matching import Match
from rce.mapping.motion import Motion
from rce.mapping.scans import Scan
from rce.mapping.state import Reader, State, optional, pack

MOVE, TURN = 0.2, 0.1  # metres, radians between scans that are kept


@dataclass(frozen=True, slots=True)
class _Kept:
    number: int
    way: float  # metres that the robot had gone then
    pose: Pose
    points: Points  # (n, 2), metres, the frame of the poses


class LaserOdometry:
    """Corrects the wheels, or does without them. Its poses drift, but hardly within what it remembers: 20 m of way
    (Hähnel et al., An Efficient FastSLAM Algorithm for Generating Maps of Large-Scale Cyclic Environments from Raw
    Laser Range Measurements, 2003, do so in front of a particle filter)."""

    def __init__(self, max_range: float) -> None:
        self._motion = Motion()
        self._local = LocalMap(self._around, max_range)
        self._kept: deque[_Kept] = deque()
        self._count = 0
        self._way = 0.0
        self._looked: Pose | None = None  # where it was last asked whether to keep a scan
        self.rolled = ORIGIN  # the pose, had the robot gone as far as the wheels say in each direction that it took

    @property
    def pose(self) -> Pose:
        return self._motion.pose

    def add(self, scan: Scan, points: Points | None) -> Match | None:
        """Take the next scan and its points (n, 2), metres, frame of the robot; None if they are too few to be matched.
        None too if the pose is that of the wheels or the last motion alone."""
        predictions = self._motion.predict(scan)
        found = self._local.match(points, predictions, self._motion.spread(scan)) if points is not None else None
        before, predicted = self.pose, predictions[0]
        pose = found.pose if found else predicted
        length = before.to(pose if scan.odometry is None else predicted)
        self.rolled = self.rolled @ length._replace(theta=before.to(pose).theta)
        self._motion.follow(scan, pose, sure=found is None or found.sure)
        if points is not None:
            self._keep(points)
        return found

    @property
    def count(self) -> int:
        """How many scans it has kept so far, with those that it has forgotten."""
        return self._count

    def seen(self, since: int = 0) -> Points:
        """All points (n, 2) of the scans kept on the way it remembers, or `since` so many, metres, frame of the robot.
        A scan that was kept just now is not among them."""
        pieces = [kept.points for kept in self._kept if kept.number >= since and kept.pose != self.pose]
        return self.pose.inverse().transform(np.concatenate([np.empty((0, 2)), *pieces]))

    def state(self) -> State:
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
            "looked": optional(self._looked),
            "rolled": optional(self.rolled),
        }

    def restore(self, saved: Reader) -> None:
        self._motion.restore(saved.part("motion"))
        self._count = saved.whole("count", 2**62)
        if saved.has("local"):
            self._local.restore(saved.part("local"), self._count)
        poses = saved.poses("poses")
        points = saved.unpack("points", np.float64)
        numbers = saved.indices("numbers", self._count, len(poses)).tolist()
        ways = saved.array("ways", np.float64, len(poses)).tolist()
        if len(points) != len(poses):
            raise saved.wrong("points", f"are of {len(points)} scans, not {len(poses)}")
        self._kept = deque(_Kept(*each) for each in zip(numbers, ways, poses, points, strict=True))
        self._way, self._looked = saved.number("way"), saved.optional("looked")
        self.rolled = saved.optional("rolled") or ORIGIN

    def _keep(self, points: Points) -> None:
        """Keep the scan if nothing near by looks the same way; forget what is too long ago."""
        pose = self.pose
        if self._looked is not None:
            step = self._looked.to(pose)
            if not step.moved(MOVE, TURN):
                return
            self._way += math.hypot(step.x, step.y) + TURN_LENGTH * abs(step.theta)
        self._looked = pose
        while self._kept and self._kept[0].way < self._way - WAY:
            self._kept.popleft()
        if all(kept.pose.to(pose).moved(MOVE, TURN) for kept in self._kept):
            kept = _Kept(self._count, self._way, pose, pose.transform(points).astype(np.float64))
            self._kept.append(kept)
            self._count += 1
            self._local.add(kept.number, kept.points)
        self._local.follow(pose)

    def _around(self, pose: Pose) -> Iterator[tuple[int, Points, Points]]:
        for kept in self._kept:
            if math.dist(kept.pose[:2], pose[:2]) < AROUND:
                yield kept.number, np.array([kept.pose[:2]]), kept.points
