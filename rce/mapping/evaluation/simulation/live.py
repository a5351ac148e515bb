"""Simulated robot that is driven step by step, for programs that decide on the way."""

from __future__ import annotations

import numpy as np

from rce.mapping.evaluation.simulation.drive import ROBOT
from rce.mapping.evaluation.simulation.floor_plan import FloorPlan
from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.scans import Scan


class LiveRobot:
    """Robot with a laser and wheels, as that of `simulate`. It does not notice walls.

    Attributes:
        plan: Floor plan of the building.
        pose: True pose, frame of the building.
    """

    def __init__(self, plan: FloorPlan, pose: Pose, seed: int = 0) -> None:
        """Put a robot into a building. The same seed gives the same noise."""
        self.plan, self.pose = plan, pose
        self._random = np.random.default_rng(seed)
        self._stamp, self._odometry = ROBOT.start, ORIGIN

    def step(self, speed: float, turn_rate: float) -> Scan:
        """Drive for one period; return what the laser and the wheels say then.

        Args:
            speed: Metres a second.
            turn_rate: Radians a second.
        """
        way, turn = speed * ROBOT.period, turn_rate * ROBOT.period
        self.pose = self.pose @ Pose(way, 0.0, turn)
        self._stamp += ROBOT.period
        slip, twist = self._random.normal(size=2).tolist()
        measured = way * (1 + ROBOT.stretch + ROBOT.step_noise * slip)
        turned = turn * (1 + ROBOT.turn_noise * twist) + ROBOT.drift * way
        self._odometry = self._odometry @ Pose(measured, 0.0, turned)
        exact = self.plan.ranges(*self.pose, ROBOT.beams, ROBOT.field_of_view)
        noisy = exact + self._random.normal(0.0, ROBOT.range_noise, ROBOT.beams)
        ranges = np.where(exact < ROBOT.range_max, noisy, np.inf).astype(np.float32)
        increment = ROBOT.field_of_view / ROBOT.beams
        return Scan(self._stamp, ranges, -ROBOT.field_of_view / 2, increment, ROBOT.range_max, self._odometry)
