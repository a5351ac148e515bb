"""A mapper node and the node of a robot, in the process of a test. Needs ROS 2."""

from __future__ import annotations

import importlib
import math
from array import array
from collections.abc import Callable
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from nav_msgs.msg import Path as PathMessage
from nav_msgs.srv import GetMap
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import LaserScan

from rce.mapping.scans import Scan
from tests.support.spin import spin_until


def stamp_of(seconds: float) -> Time:
    """Convert seconds to a stamp, rounded to nanoseconds."""
    nanoseconds = round(seconds * 1e9)
    return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


class Robot:
    """A mapper node and the node of a robot, both on one executor."""

    def __init__(self, parameters: list[Any]) -> None:
        from rce_mapping.inputs import LOSSLESS
        from rce_mapping.map_output import LATCHED
        from rce_mapping.node import MapperNode

        self.mapper = MapperNode()
        self.node = rclpy.create_node("robot")
        self.poses: list[PoseWithCovarianceStamped] = []
        self.maps: list[OccupancyGrid] = []
        self.paths: list[PathMessage] = []
        self.node.create_subscription(PoseWithCovarianceStamped, "pose", self.poses.append, LOSSLESS)
        self.node.create_subscription(OccupancyGrid, "map", self.maps.append, LATCHED)
        self.node.create_subscription(PathMessage, "path", self.paths.append, LATCHED)
        self.scans = self.node.create_publisher(LaserScan, "scan", LOSSLESS)
        self.odometry = self.node.create_publisher(Odometry, "odom", LOSSLESS)
        self.client: Any = self.node.create_client(GetMap, "dynamic_map")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.mapper)
        self.executor.add_node(self.node)
        self.mapper.set_parameters(parameters)
        self.until(lambda: bool(self.maps) and self.scans.get_subscription_count() == 1)
        # Poses are not latched: an answer to a scan is lost unless the mapper has discovered the subscription.
        self.until(lambda: self.mapper.track._pose_out.get_subscription_count() == 1)
        self.until(self.client.service_is_ready)

    def until(self, condition: Callable[[], bool]) -> None:
        spin_until(self.executor, condition)

    def until_poses(self, count: int) -> None:
        """Wait until this many scans were answered."""
        self.until(lambda: len(self.poses) == count)

    def send_scan(self, scan: Scan, frame: str = "base_link") -> None:
        message = LaserScan(angle_min=scan.angle_min, angle_increment=scan.angle_increment, range_max=scan.range_max)
        message.header.stamp, message.header.frame_id = stamp_of(scan.stamp), frame
        message.ranges = array("f", scan.ranges.tobytes())
        self.scans.publish(message)

    def send_odometry(self, scan: Scan) -> None:
        self.until(lambda: self.odometry.get_subscription_count() == 1)
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


def call(robot: Robot, package: str, kind: str, name: str, /, **fields: Any) -> Any:
    """Call a service of the mapper; return the response."""
    service = getattr(importlib.import_module(f"{package}.srv"), kind)
    client: Any = robot.node.create_client(service, name)
    robot.until(client.service_is_ready)
    answer = client.call_async(service.Request(**fields))
    robot.until(answer.done)
    return answer.result()


def transform(parent: str, child: str, x: float, theta: float, stamp: Time) -> TransformStamped:
    """Return a transform in the plane: `x` along the axis, `theta` about it."""
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.header.stamp = parent, stamp
    message.transform.translation.x = x
    message.transform.rotation.z, message.transform.rotation.w = math.sin(theta / 2), math.cos(theta / 2)
    return message
