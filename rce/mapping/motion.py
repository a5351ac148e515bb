"""Where the robot may be before its scan is looked at."""

from __future__ import annotations

import math

import numpy as np

from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.scans import Scan
from rce.mapping.state import Reader, State, optional

RESET = 10.0  # metres; if odometry moves this far between two scans, it was set anew
SHORTEST = 1e-3  # seconds; no laser is faster
WHEELS, SLIP = 0.03, 0.1  # metres, and metres a metre, by which wheels are off as a rule
STEADINESS = 0.1  # metres by which a robot that goes on as it did is off after a scan
STEADY = 0.5  # seconds for which a robot may be supposed to go on as it did


class Motion:
    """Predicts by two means, the motion by odometry and the last motion repeated, since wheels slip and odometry comes
    late or not at all. The first scan is at `pose`, map frame."""

    def __init__(self, pose: Pose = ORIGIN) -> None:
        self.pose = pose
        self._stamp: float | None = None
        self._steady = True  # whether the last motion took no longer than STEADY, so that the next is like it
        self._last = ORIGIN  # motion from the scan before the last to the last, so far as it is known
        self._wheels: tuple[Pose, Pose] | None = None  # last odometry, and the pose of the robot then

    def predict(self, scan: Scan) -> list[Pose]:
        """Where the robot may be now, the most trusted first."""
        if self._stamp is None:
            return [self.pose]
        repeated = self.pose @ self._last
        if scan.odometry is None or self._wheels is None:
            return [repeated, self.pose] if self._blind(scan) else [repeated]
        odometry, pose = self._wheels
        motion = odometry.to(scan.odometry)
        plausible = math.hypot(motion.x, motion.y) < RESET  # False for NaN
        if not plausible:
            return [repeated]
        return [pose @ motion, repeated] if scan.stamp - self._stamp < STEADY else [pose @ motion]

    def spread(self, scan: Scan) -> float:
        """Metres by which the first prediction is off, if things are as usual; infinite if nothing is known."""
        if self._blind(scan):
            return math.inf
        if scan.odometry is None or self._wheels is None:
            return STEADINESS
        return math.hypot(WHEELS, SLIP * math.dist(self._wheels[0][:2], scan.odometry[:2]))

    def _blind(self, scan: Scan) -> bool:
        """Whether nothing tells how far the robot went: it has no wheels, and scans are too rare, or their stamps
        (which logs may have lost) too close, to suppose that it goes on as it did."""
        return scan.odometry is None and not (self._steady and self._soon(scan))

    def _soon(self, scan: Scan) -> bool:
        return self._stamp is not None and SHORTEST < scan.stamp - self._stamp < STEADY

    def state(self) -> State:
        return {
            "pose": optional(self.pose),
            "steady": np.array(self._steady),
            "stamp": np.array([] if self._stamp is None else [self._stamp], np.float64),
            "last": optional(self._last),
            "wheels": np.array(self._wheels or [], np.float64).reshape(-1, 3),
        }

    def restore(self, saved: Reader) -> None:
        self._steady = bool(saved.array("steady", np.bool_))
        stamps, wheels = saved.array("stamp", np.float64, None).tolist(), saved.poses("wheels")
        self.pose, self._last = saved.optional("pose") or ORIGIN, saved.optional("last") or ORIGIN
        self._stamp = stamps[0] if stamps else None
        self._wheels = (wheels[0], wheels[1]) if len(wheels) == 2 else None

    def follow(self, scan: Scan, pose: Pose, sure: bool = True) -> None:
        """Take the pose at which a scan was found to be; one that is not `sure` says nothing about the next motion."""
        if sure:
            self._last = ORIGIN if self._stamp is None else self.pose.to(pose)
        self._steady = self._stamp is None or self._soon(scan)
        self._stamp, self.pose = scan.stamp, pose
        if scan.odometry is not None:
            self._wheels = scan.odometry, pose

    def correct(self, pose: Pose) -> None:
        """The pose of the last scan has turned out to be `pose`."""
        if self._wheels is not None:
            odometry, then = self._wheels
            self._wheels = odometry, pose @ self.pose.to(then)
        self.pose = pose
