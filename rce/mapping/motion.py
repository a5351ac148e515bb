"""Prediction of the robot's pose before its scan is matched."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.odometry_scale import OdometryScale
from rce.mapping.scans import Scan
from rce.mapping.state import Reader, State, optional
from rce.mapping.steps import Steps


@dataclass(frozen=True, slots=True)
class MotionSettings:
    """Settings of the motion model.

    Attributes:
        reset_distance: Metres; odometry that moves this far between two scans was reset.
        min_period: Seconds; shorter periods between stamps mean that the stamps are wrong, since no laser is faster.
        max_period: Seconds for which the robot is assumed to keep its velocity.
        wheel_noise: Metres by which wheel odometry is usually off.
        wheel_slip: Metres a metre by which wheel odometry is usually off.
        velocity_noise: Metres by which a robot that keeps its velocity is off after a scan.
    """

    reset_distance: float = 10.0
    min_period: float = 1e-3
    max_period: float = 0.5
    wheel_noise: float = 0.03
    wheel_slip: float = 0.1
    velocity_noise: float = 0.1


SETTINGS = MotionSettings()


class Motion:
    """Motion model with two predictions: the motion by odometry, and the last motion repeated (constant velocity).

    There are two because wheels slip, and odometry comes late or not at all. Lengths by the wheels are corrected by
    their scale, which is estimated on the way.

    Attributes:
        pose: Pose of the robot at the last scan, map frame.
    """

    def __init__(self, pose: Pose = ORIGIN) -> None:
        """Start at a pose in the map frame."""
        self.pose = pose
        self._stamp: float | None = None
        self._steady = True  # whether the last motion took less than max_period, so that the next is like it
        self._last = ORIGIN  # motion between the last two scans, so far as it is known
        self._wheels: tuple[Pose, Pose] | None = None  # last odometry, and the pose of the robot then
        self._scale = OdometryScale()
        self._steps = Steps()  # of scans whose motion nothing predicts

    def predict(self, scan: Scan) -> list[Pose]:
        """Return the predicted poses of the robot at a scan, the most trusted first."""
        if self._stamp is None:
            return [self.pose]
        repeated = self.pose @ self._last
        if scan.odometry is None or self._wheels is None:
            return [repeated, self.pose] if self._is_unpredictable(scan) else [repeated]
        odometry, pose = self._wheels
        motion = self._scale.correct(odometry.to(scan.odometry))
        plausible = math.hypot(motion.x, motion.y) < SETTINGS.reset_distance  # False for NaN
        if not plausible:
            return [repeated]
        return [pose @ motion, repeated] if scan.stamp - self._stamp < SETTINGS.max_period else [pose @ motion]

    def spread(self, scan: Scan) -> float:
        """Return the metres by which the first prediction is usually off; infinite if nothing is known."""
        if self._is_unpredictable(scan):
            return math.inf
        if scan.odometry is None or self._wheels is None:
            return SETTINGS.velocity_noise
        way = math.dist(self._wheels[0][:2], scan.odometry[:2])
        return math.hypot(SETTINGS.wheel_noise, SETTINGS.wheel_slip * way)

    def step_cost(self, pose: Pose) -> float:
        """Return the penalty, in mean likelihood of a scan, of a pose to which nothing predicts the motion."""
        return self._steps.cost(self.pose.to(pose))

    def _is_unpredictable(self, scan: Scan) -> bool:
        """Return whether nothing predicts the motion of the robot.

        That is the case without odometry if scans are too rare to assume a constant velocity, or their stamps too
        close: some logs have lost them.
        """
        return scan.odometry is None and not (self._steady and self._follows_soon(scan))

    def _follows_soon(self, scan: Scan) -> bool:
        if self._stamp is None:
            return False
        return SETTINGS.min_period < scan.stamp - self._stamp < SETTINGS.max_period

    def state(self) -> State:
        """Return the model as arrays to save."""
        return {
            "pose": optional(self.pose),
            "steady": np.array(self._steady),
            "stamp": np.array([] if self._stamp is None else [self._stamp], np.float64),
            "last": optional(self._last),
            "wheels": np.array(self._wheels or [], np.float64).reshape(-1, 3),
            "scale": self._scale.state(),
            "steps": self._steps.state(),
        }

    def restore(self, saved: Reader) -> None:
        """Replace the model by a saved one.

        Raises:
            InvalidRequest: The saved arrays are not a motion model.
        """
        self._steady = bool(saved.array("steady", np.bool_))
        stamps, wheels = saved.array("stamp", np.float64, None).tolist(), saved.poses("wheels")
        self.pose, self._last = saved.optional("pose") or ORIGIN, saved.optional("last") or ORIGIN
        self._stamp = stamps[0] if stamps else None
        self._scale.restore(saved.part("scale"))
        self._steps.restore(saved.part("steps"))
        self._wheels = (wheels[0], wheels[1]) if len(wheels) == 2 else None

    def update(
        self, scan: Scan, pose: Pose, reliable: bool = True, covariance: NDArray[np.float64] | None = None
    ) -> None:
        """Set the pose of a scan.

        Args:
            scan: The scan.
            pose: Pose of the robot, map frame.
            reliable: Whether the motion to this pose predicts the next one.
            covariance: (3, 3) of x, y, theta of a pose that was matched, map frame; None if it was not.
        """
        if covariance is not None and self._stamp is not None and self._is_unpredictable(scan):
            self._steps.add(self.pose.to(pose))
        if reliable:
            self._last = ORIGIN if self._stamp is None else self.pose.to(pose)
        self._steady = self._stamp is None or self._follows_soon(scan)
        self._stamp, self.pose = scan.stamp, pose
        if scan.odometry is not None:
            self._wheels = scan.odometry, pose
            if reliable and covariance is not None:
                self._scale.observe(scan.odometry, pose, covariance)
            else:
                self._scale.interrupt()

    def correct(self, pose: Pose) -> None:
        """Move the last scan to `pose`, as an optimisation has found."""
        self._scale.interrupt()
        if self._wheels is not None:
            odometry, then = self._wheels
            self._wheels = odometry, pose @ self.pose.to(then)
        self.pose = pose
