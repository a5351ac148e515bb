"""Pose of the robot from transforms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rce.mapping.geometry import Pose


def test_pose_is_that_of_the_chain_of_frames(start_ros: Callable[..., None]) -> None:
    import rclpy
    from builtin_interfaces.msg import Time
    from rce_mapping.optional import TFMessage
    from rce_planning.transforms import RobotPose

    from tests.support.containers.mapper_robot import transform

    start_ros()
    robot = RobotPose(rclpy.create_node("planner"), "map", "base_link")
    assert robot.newest() is None
    robot.take(TFMessage(transforms=[transform("odom", "base_link", 2.0, 0.0, Time())]))
    assert robot.newest() is None
    robot.take(TFMessage(transforms=[transform("/map", "/odom", 1.0, np.pi / 2, Time())]))
    assert np.allclose(robot.newest() or (), Pose(1.0, 2.0, np.pi / 2))
    robot.take(TFMessage(transforms=[transform("base_link", "odom", 0.0, 0.0, Time())]))
    assert robot.newest() is None  # frames in a circle
