"""Tests of the ROS 2 node `team`."""

# ruff: noqa: E402  (ROS is imported only if it is installed)

from __future__ import annotations

import json
from array import array
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from rce.errors import InvalidRequest
from rce.mapping.evaluation.simulation import Simulation
from tests.support.spin import spin_until

rclpy = pytest.importorskip("rclpy", reason="needs the extra `ros`")

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String

NAMES = "one", "two"


def _answered(poses: list[Any], count: int) -> bool:
    return len(poses) == count


def test_each_robot_is_answered_on_its_own_topics(start_ros: Callable[..., None], simulation: Simulation) -> None:
    start_ros("robots:=[one, two]")
    from rce_mapping.map_output import LATCHED
    from rce_mapping.team import TeamNode

    team, node = TeamNode(), rclpy.create_node("robots")
    executor = SingleThreadedExecutor()
    executor.add_node(team)
    executor.add_node(node)
    teams: dict[str, list[Any]] = {name: [] for name in NAMES}
    poses: dict[str, list[Any]] = {name: [] for name in NAMES}
    out = {name: node.create_publisher(LaserScan, f"{name}/scan", 10) for name in NAMES}
    for name in NAMES:
        node.create_subscription(String, f"{name}/team", teams[name].append, LATCHED)
        node.create_subscription(PoseWithCovarianceStamped, f"{name}/pose", poses[name].append, 10)

    until = partial(spin_until, executor)
    try:
        until(lambda: all(each.get_subscription_count() for each in out.values()))
        until(lambda: all(teams.values()))
        # Poses are not latched: an answer is lost unless the node has discovered the subscription.
        until(lambda: all(team._members[name]._track._pose_out.get_subscription_count() for name in NAMES))
        assert [json.loads(each[-1].data) for each in teams.values()] == [["one"], ["two"]]
        for count, scan in enumerate(simulation.records[:5], 1):
            for name, publisher in out.items():
                message = LaserScan(angle_min=scan.angle_min, angle_increment=scan.angle_increment)
                message.range_max, message.ranges = scan.range_max, array("f", scan.ranges.tobytes())
                message.header.stamp = Time(sec=int(scan.stamp), nanosec=int(scan.stamp % 1 * 1e9))
                publisher.publish(message)
                until(partial(_answered, poses[name], count))
    finally:
        executor.shutdown()
        team.destroy_node()
        node.destroy_node()


def test_team_needs_robots(start_ros: Callable[..., None]) -> None:
    from rce_mapping.team import TeamNode

    start_ros()
    with pytest.raises(InvalidRequest, match="robots"):
        TeamNode()
