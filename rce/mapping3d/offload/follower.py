"""A pose that follows corrections without jumps, so that whatever steers by it stays calm."""

from __future__ import annotations

import math

import numpy as np

from rce.mapping3d.poses import Pose, distance, interpolate, inverse


class PoseFollower:
    """The pose that a robot acts on.

    A correction of the map does not move it at once: the difference goes away exponentially. The motion of the robot
    itself is followed without delay.
    """

    def __init__(self, seconds: float = 0.5, jump: float = 1.0) -> None:
        """Begin.

        Args:
            seconds: Time in which a correction is done to 63 %.
            jump: Metres from which on a correction is done at once: the robot was found elsewhere.
        """
        self._seconds, self._jump = seconds, jump
        self._rest = np.eye(4)  # what is still to be corrected, in the frame of the robot
        self._stamp = -math.inf
        self._target: Pose | None = None

    def move(self, stamp: float, target: Pose) -> Pose:
        """Return the pose at a stamp, at which the map now says `target` (4, 4)."""
        if self._target is not None:
            share = 1.0 - math.exp(-max(stamp - self._stamp, 0.0) / self._seconds)
            self._rest = interpolate(self._rest, np.eye(4), share)
        self._stamp, self._target = stamp, target
        return target @ self._rest

    def correct(self, target: Pose) -> None:
        """Take note that the map now says `target` for the moment of the last motion."""
        if self._target is None:
            return
        rest = inverse(target) @ self._target @ self._rest
        self._rest = rest if distance(rest) < self._jump else np.eye(4)
        self._target = target
