"""The simulated robot that is driven step by step."""

from __future__ import annotations

import math

import pytest

from rce.mapping.evaluation.simulation.floor_plan import apartment
from rce.mapping.evaluation.simulation.live import LiveRobot
from rce.mapping.geometry import Pose


def test_robot_drives_and_measures() -> None:
    robot = LiveRobot(apartment(), Pose(1.0, 5.5, 0.0))
    scans = [robot.step(1.0, 0.0) for _ in range(10)] + [robot.step(0.0, math.pi / 2) for _ in range(10)]
    assert robot.pose == pytest.approx((2.0, 5.5, math.pi / 2))
    assert scans[-1].stamp - scans[0].stamp == pytest.approx(1.9)
    odometry = scans[-1].odometry
    assert odometry is not None
    assert odometry.x == pytest.approx(1.03, abs=0.1)
    assert odometry.theta == pytest.approx(math.pi / 2 + 0.02, abs=0.1)
    assert scans[-1].ranges[180] == pytest.approx(6.3 - 0.06 - 5.5, abs=0.05), "the wall of the corridor"


def test_same_seed_gives_the_same_noise() -> None:
    first, second = (LiveRobot(apartment(), Pose(1.0, 5.5, 0.0)).step(1.0, 0.1) for _ in range(2))
    assert first.odometry == second.odometry
    assert (first.ranges == second.ranges).all()
