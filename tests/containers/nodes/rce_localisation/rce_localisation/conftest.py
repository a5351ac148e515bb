"""The localiser node and the node of a robot, on one executor."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from rce.mapping.geometry import Pose
from rce.mapping.grid import OccupancyGrid
from rce.mapping.scans import Scan
from tests.support.spin import spin_until


class World:
    """A localiser node and a robot, whose scans are answered in the same turn."""

    def __init__(self) -> None:
        import rclpy
        from geometry_msgs.msg import PoseWithCovarianceStamped
        from rce_localisation.node import LocaliserNode
        from rce_mapping.map_output import LATCHED
        from rclpy.executors import SingleThreadedExecutor
        from std_msgs.msg import Bool
        from tf2_msgs.msg import TFMessage

        self.localiser = LocaliserNode()
        self.node = rclpy.create_node("robot")
        self.poses: list[Any] = []
        self.localised: list[bool] = []
        self.transforms: list[Any] = []
        self.node.create_subscription(PoseWithCovarianceStamped, "amcl_pose", self.poses.append, LATCHED)
        self.node.create_subscription(Bool, "localised", lambda message: self.localised.append(message.data), LATCHED)
        self.node.create_subscription(TFMessage, "/tf", lambda each: self.transforms.extend(each.transforms), 100)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.localiser)
        self.executor.add_node(self.node)

    def until(self, condition: Callable[[], bool]) -> None:
        spin_until(self.executor, condition)

    def give_map(self, grid: OccupancyGrid) -> None:
        """Publish a map as map_server does, and wait until the node has it."""
        from builtin_interfaces.msg import Time
        from nav_msgs.msg import OccupancyGrid as GridMessage
        from rce_mapping.map_output import LATCHED
        from rce_mapping.messages import grid_message

        before = self.localiser._localiser
        self.node.create_publisher(GridMessage, "map", LATCHED).publish(grid_message(grid, Time(sec=1), "map"))
        self.until(lambda: self.localiser._localiser is not before)

    def scan(self, scan: Scan) -> None:
        """Let the node receive a scan with its odometry."""
        from rce_mapping.messages import stamp_of
        from sensor_msgs.msg import LaserScan

        message = LaserScan(angle_min=scan.angle_min, angle_increment=scan.angle_increment, range_max=scan.range_max)
        message.header.stamp, message.header.frame_id = stamp_of(scan.stamp), "base_link"
        message.ranges = array("f", scan.ranges.tobytes())
        if scan.odometry is not None:
            self.localiser._scans._on_odometry(message.header.stamp, scan.odometry)
        self.localiser._scans._on_scan(message)

    def call(self, name: str) -> None:
        """Call a service of the node, which has no fields."""
        from std_srvs.srv import Empty

        client: Any = self.node.create_client(Empty, name)
        self.until(client.service_is_ready)
        answer = client.call_async(Empty.Request())
        self.until(answer.done)

    def give_pose(self, pose: Pose, frame: str = "map") -> None:
        """Send an initial pose, as rviz does."""
        from geometry_msgs.msg import PoseWithCovarianceStamped
        from rce_mapping.messages import fill_pose

        message = PoseWithCovarianceStamped()
        message.header.frame_id = frame
        fill_pose(message.pose.pose, *pose)
        self.localiser._on_initial_pose(message)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.localiser.destroy_node()


@pytest.fixture
def start(start_ros: Callable[..., None]) -> Iterator[Callable[..., World]]:
    """`start("name:=value")` starts a localiser node with parameters."""
    worlds: list[World] = []

    def start(*parameters: str) -> World:
        start_ros(*parameters)
        worlds.append(World())
        return worlds[-1]

    yield start
    for world in worlds:
        world.close()
