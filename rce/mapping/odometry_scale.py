"""Scale of wheel odometry, estimated while the robot drives."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Pose
from rce.mapping.state import Reader, State


@dataclass(frozen=True, slots=True)
class ScaleSettings:
    """Settings of the estimate.

    Attributes:
        step: Metres by the wheels between two poses that are compared.
        prior: Standard deviation of the factor before the robot has moved.
        wheel_noise: Standard deviation of a step by the wheels, as a share of it.
        match_scale: Factor of the covariance of a match, since the points of a scan are not independent.
        match_noise: Metres; standard deviation of a match at least, since maps are not exact.
        precision: Standard deviation of the factor at least, so that the estimate follows a change.
        outlier: Standard deviations from which on a step is a slip.
        limits: The least and the greatest factor.
    """

    step: float = 0.5
    prior: float = 0.1
    wheel_noise: float = 0.1
    match_scale: float = 4.0
    match_noise: float = 0.02
    precision: float = 0.005
    outlier: float = 3.0
    limits: tuple[float, float] = (0.7, 1.4)


SETTINGS = ScaleSettings()


class OdometryScale:
    """Factor from lengths by the wheels to lengths in the map.

    Wheels that are worn, or whose radius is not known well, measure all lengths too long or too short by the same
    factor. A Kalman filter with this factor as its state compares steps by the wheels with those by scan matching (Roy
    and Thrun, Online Self-Calibration for Mobile Robots, 1999, with the filter in place of their gradient).

    Attributes:
        factor: The factor.
        variance: Its variance.
    """

    def __init__(self) -> None:
        """Trust the wheels."""
        self.factor = 1.0
        self.variance = SETTINGS.prior**2
        self._start: tuple[Pose, Pose] | None = None  # odometry and pose in the map at the start of the step

    def correct(self, motion: Pose) -> Pose:
        """Return a motion by the wheels with its length in the map."""
        return motion._replace(x=motion.x * self.factor, y=motion.y * self.factor)

    def observe(self, odometry: Pose, pose: Pose, covariance: NDArray[np.float64]) -> None:
        """Compare the wheels with a pose that was matched, once the robot has moved far enough.

        Args:
            odometry: Pose by the wheels.
            pose: Pose in the map at the same time.
            covariance: (3, 3) of x, y, theta of the pose in the map, as if the points of the scan were independent.
        """
        if self._start is None:
            self._start = odometry, pose
            return
        length = math.dist(self._start[0][:2], odometry[:2])
        if length < SETTINGS.step:
            return
        self._update(math.dist(self._start[1][:2], pose[:2]) / length, self._noise(length, pose, covariance))
        self._start = odometry, pose

    def interrupt(self) -> None:
        """Begin a new step: a pose is in doubt, or was moved by an optimisation."""
        self._start = None

    def state(self) -> State:
        """Return the estimate as arrays to save."""
        return {
            "estimate": np.array([self.factor, self.variance]),
            "start": np.array(self._start or [], np.float64).reshape(-1, 3),
        }

    def restore(self, saved: Reader) -> None:
        """Replace the estimate by a saved one.

        Raises:
            InvalidRequest: The saved arrays are not an estimate.
        """
        factor, variance = saved.array("estimate", np.float64, 2).tolist()
        low, high = SETTINGS.limits
        if not (low <= factor <= high and variance > 0):
            raise saved.invalid("estimate", "is out of range")
        start = saved.poses("start")
        self.factor, self.variance = factor, variance
        self._start = (start[0], start[1]) if len(start) == 2 else None

    def _noise(self, length: float, pose: Pose, covariance: NDArray[np.float64]) -> float:
        """Return the variance of the factor that one step of this length shows."""
        assert self._start is not None
        along = np.subtract(pose[:2], self._start[1][:2])
        along = along / max(float(np.hypot(*along)), 1e-9)
        matched = SETTINGS.match_scale * float(along @ covariance[:2, :2] @ along) + SETTINGS.match_noise**2
        return SETTINGS.wheel_noise**2 + matched / length**2

    def _update(self, seen: float, noise: float) -> None:
        """Update the factor with one that was seen with this variance."""
        off, total = seen - self.factor, self.variance + noise
        if not off**2 < SETTINGS.outlier**2 * total:  # also NaN
            return
        low, high = SETTINGS.limits
        self.factor = min(max(self.factor + self.variance / total * off, low), high)
        self.variance = max(self.variance * noise / total, SETTINGS.precision**2)
