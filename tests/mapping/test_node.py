"""The ROS 2 node, with a robot beside it in the same process."""

# ruff: noqa: E402  (ROS is imported only where it is there)

from __future__ import annotations

import math
import os
import sys
from array import array
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rce.mapping.scans import Scan
from rce.mapping.simulation import Simulation

rclpy = pytest.importorskip("rclpy", reason="needs the extra `ros`")

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from nav_msgs.msg import Path as PathMessage
from nav_msgs.srv import GetMap
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from sensor_msgs.msg import LaserScan

PACKAGE = Path(__file__).parents[2] / "containers" / "nodes" / "rce_mapping"
TURNS = 2000  # of the executor before a test gives up; far more than is needed


def stamp_of(seconds: float) -> Time:
    nanoseconds = round(seconds * 1e9)
    return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


class Robot:
    """A mapper node, and a robot that talks to it; `turn` lets both do what there is to do."""

    def __init__(self, parameters: list[Any]) -> None:
        from rce_mapping import node

        self.mapper = node.MapperNode()
        self.node = rclpy.create_node("robot")
        self.poses: list[PoseWithCovarianceStamped] = []
        self.maps: list[OccupancyGrid] = []
        self.paths: list[PathMessage] = []
        self.node.create_subscription(PoseWithCovarianceStamped, "pose", self.poses.append, node.EVERYTHING)
        self.node.create_subscription(OccupancyGrid, "map", self.maps.append, node.LATCHED)
        self.node.create_subscription(PathMessage, "path", self.paths.append, node.LATCHED)
        self.scans = self.node.create_publisher(LaserScan, "scan", node.EVERYTHING)
        self.odometry = self.node.create_publisher(Odometry, "odom", node.EVERYTHING)
        self.client = self.node.create_client(GetMap, "dynamic_map")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.mapper)
        self.executor.add_node(self.node)
        self.mapper.set_parameters(parameters)
        self.until(lambda: bool(self.maps) and self.scans.get_subscription_count() == 1)
        self.until(lambda: self.odometry.get_subscription_count() == 1 and self.client.service_is_ready())

    def until(self, done: Callable[[], bool]) -> None:
        for _ in range(TURNS):
            if done():
                return
            self.executor.spin_once(timeout_sec=0.05)
        raise AssertionError("it never came to that")

    def send_scan(self, scan: Scan) -> None:
        message = LaserScan(angle_min=scan.angle_min, angle_increment=scan.angle_increment, range_max=scan.range_max)
        message.header.stamp = stamp_of(scan.stamp)
        message.ranges = array("f", scan.ranges.tobytes())
        self.scans.publish(message)

    def send_odometry(self, scan: Scan) -> None:
        assert scan.odometry
        message = Odometry()
        message.header.stamp = stamp_of(scan.stamp)
        message.pose.pose.position.x, message.pose.pose.position.y, theta = scan.odometry
        message.pose.pose.orientation.z, message.pose.pose.orientation.w = math.sin(theta / 2), math.cos(theta / 2)
        self.odometry.publish(message)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.mapper.destroy_node()


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> Iterator[Robot]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setattr(sys, "path", [str(PACKAGE), *sys.path])
    rclpy.init(domain_id=os.getpid() % 100 + 1)
    robot = Robot([Parameter("map_update_interval", value=3600.0)])
    yield robot
    robot.close()
    rclpy.shutdown()


def test_every_scan_is_answered_with_its_stamp_and_mapped(robot: Robot, simulation: Simulation) -> None:
    assert (robot.maps[0].info.width, list(robot.maps[0].data)) == (1, [-1]), "an empty map says that it is ready"
    sent = simulation.records[:40]
    for i, scan in enumerate(sent):
        for send in (robot.send_scan, robot.send_odometry)[:: 1 if i % 2 else -1]:
            send(scan)
    robot.until(lambda: len(robot.poses) == len(sent))
    assert [pose.header.stamp for pose in robot.poses] == [stamp_of(scan.stamp) for scan in sent]
    assert {pose.header.frame_id for pose in robot.poses} == {"map"}
    covariance = np.array(robot.poses[-1].pose.covariance).reshape(6, 6)
    assert np.diag(covariance)[[0, 1, 5]].min() > 0

    answer = robot.client.call_async(GetMap.Request())
    robot.until(lambda: answer.done() and len(robot.maps) == 2 and bool(robot.paths[-1].poses))
    assert answer.result().map == robot.maps[-1]
    assert robot.maps[-1].info.width * robot.maps[-1].info.height == len(robot.maps[-1].data)
    assert max(robot.maps[-1].data) > 65
    assert [pose.header.stamp for pose in robot.paths[-1].poses] == [stamp_of(scan.stamp) for scan in sent]
    last, said = robot.paths[-1].poses[-1].pose, robot.poses[-1].pose.pose
    assert (last.position.x, last.position.y) == pytest.approx((said.position.x, said.position.y), abs=1e-9)


def test_without_odometry_and_with_unusable_scans_every_scan_is_answered(robot: Robot, simulation: Simulation) -> None:
    sent = [*simulation.records[:3], Scan(1.8e9, np.empty(0, np.float32), 0.0, 0.0, 0.0), simulation.records[3]]
    for scan in sent:
        robot.send_scan(scan)
    robot.until(lambda: len(robot.poses) == len(sent))
    assert [pose.header.stamp for pose in robot.poses] == [stamp_of(scan.stamp) for scan in sent]


def test_a_scan_that_comes_again_is_answered_but_not_mapped(robot: Robot, simulation: Simulation) -> None:
    for scan in (*simulation.records[:3], simulation.records[1]):
        robot.send_scan(scan)
    robot.until(lambda: len(robot.poses) == 4)
    answer = robot.client.call_async(GetMap.Request())
    robot.until(lambda: answer.done() and bool(robot.paths[-1].poses))
    assert len(robot.paths[-1].poses) == 3


def test_an_unknown_mapper_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [str(PACKAGE), *sys.path])
    rclpy.init(args=["--ros-args", "-p", "mapper:=best"])
    try:
        from rce_mapping import node

        with pytest.raises(ValueError, match="'best'; it may be: graph"):
            node.MapperNode()
    finally:
        rclpy.shutdown()
