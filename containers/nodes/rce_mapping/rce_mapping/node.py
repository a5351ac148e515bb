"""A mapper as a ROS 2 node.

In: `scan`, `odom`. Out: `map` (its first publication, still empty, says that the node is ready), `pose` (one for each
scan, with the stamp of the scan, whatever the scan is worth: it is also the acknowledgement that lets a sender pace
itself), `path`, and `tf` where tf2_msgs is installed. Service: `dynamic_map`.
"""

from __future__ import annotations

import time
from collections import deque

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from nav_msgs.srv import GetMap
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import LaserScan

from rce.mapping.mapper import MapperSettings
from rce.mapping.mappers import MAPPERS
from rce.mapping.pairing import OdometryPairing
from rce.mapping.scans import Scan

from . import messages
from .parameters import INTERVAL, MAPPER, choice, declare, number, text
from .transforms import TransformSender

EVERYTHING = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
CHECK = 0.1  # seconds between looks at scans that wait for odometry


class MapperNode(Node):
    """Feeds a mapper with what arrives and publishes what it says."""

    def __init__(self) -> None:
        super().__init__("mapper")
        declare(self, list(MAPPERS))
        settings = MapperSettings(
            resolution=number(self, "resolution"),
            max_range=number(self, "max_range"),
            particles=int(number(self, "particles")),
            seed=int(number(self, "seed")),
        )
        self._mapper = MAPPERS[choice(self, MAPPER, list(MAPPERS))](settings)
        self._pairing = OdometryPairing()
        self._arrivals: deque[tuple[Time, float]] = deque()  # stamp and monotonic time, of each scan that waits
        self._odometry_expected = bool(self.get_parameter("use_odometry").value)
        self._timeout = number(self, "odom_timeout")
        self._stamps: list[Time] = []  # of the scans that were mapped
        self._published = -1  # how many of them the last map has
        self._frame = text(self, "map_frame")
        self._transforms = TransformSender(self, self._frame, text(self, "odom_frame"), text(self, "base_frame"))
        self._map_out = self.create_publisher(OccupancyGrid, "map", LATCHED)
        self._path_out = self.create_publisher(Path, "path", LATCHED)
        self._pose_out = self.create_publisher(PoseWithCovarianceStamped, "pose", EVERYTHING)
        if self._odometry_expected:
            self.create_subscription(Odometry, "odom", self._on_odometry, EVERYTHING)
        self.create_subscription(LaserScan, "scan", self._on_scan, EVERYTHING)
        self.create_service(GetMap, "dynamic_map", self._on_get_map)
        self.create_timer(CHECK, self._end_wait)
        self._map_timer = self.create_timer(number(self, INTERVAL), self._publish)
        self.add_post_set_parameters_callback(self._on_parameters)
        self._publish()

    def _on_odometry(self, message: Odometry) -> None:
        self._odometry_expected = True
        self._pairing.add_odometry(messages.seconds(message.header.stamp), messages.pose_from(message))
        self._map(self._pairing.ready())

    def _on_scan(self, message: LaserScan) -> None:
        self._arrivals.append((message.header.stamp, time.monotonic()))
        self._pairing.add_scan(messages.scan_from(message))
        self._map(self._pairing.ready() if self._odometry_expected else self._pairing.flush())

    def _end_wait(self) -> None:
        """Map scans whose odometry does not come. Until there is some again, no other scan waits."""
        if self._arrivals and time.monotonic() - self._arrivals[0][1] > self._timeout:
            self._odometry_expected = False
            self._map(self._pairing.flush())

    def _map(self, scans: list[Scan]) -> None:
        for scan in scans:
            stamp, _ = self._arrivals.popleft()
            estimate = self._mapper.add(scan)
            if estimate.taken:
                self._stamps.append(stamp)
            self._pose_out.publish(messages.pose_message(estimate, stamp, self._frame))
            self._transforms.send(stamp, estimate.pose, scan.odometry)

    def _publish(self) -> None:
        """Publish map and path, if there is anything new."""
        if self._published != len(self._stamps):
            self._publish_path()
            self._publish_map()

    def _publish_path(self) -> None:
        self._path_out.publish(messages.path_message(self._mapper.trajectory(), self._stamps, self._frame))

    def _publish_map(self) -> OccupancyGrid:
        stamp = self._stamps[-1] if self._stamps else self.get_clock().now().to_msg()
        message = messages.grid_message(self._mapper.grid(), stamp, self._frame)
        self._map_out.publish(message)
        self._published = len(self._stamps)
        return message

    def _on_get_map(self, _request: GetMap.Request, response: GetMap.Response) -> GetMap.Response:
        self._publish_path()
        response.map = self._publish_map()
        return response

    def _on_parameters(self, parameters: list[Parameter[float]]) -> None:
        for parameter in parameters:
            if parameter.name == INTERVAL:
                self.destroy_timer(self._map_timer)
                self._map_timer = self.create_timer(parameter.value, self._publish)
