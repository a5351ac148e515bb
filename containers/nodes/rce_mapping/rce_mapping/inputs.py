"""Inputs of a mapper: scans, odometry from a topic or from tf, and static transforms."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.event_handler import QoSMessageLostInfo, QoSRequestedIncompatibleQoSInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import LaserScan

from rce.mapping.geometry import ORIGIN, Pose

from . import messages
from .optional import TFMessage

LOSSLESS = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)
BEST_EFFORT = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
STATIC_TRANSFORMS = QoSProfile(
    depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
LOG_EVERY = 100  # lost scans from one warning to the next; the first loss is logged at once


class ScanInput:
    """Subscription to scans: reliable, so that a recording arrives complete, or best effort if a driver offers no more.

    Scans that ROS drops because the mapper does not keep up are counted and logged.

    Attributes:
        lost: Number of scans that were dropped.
    """

    def __init__(self, node: Node, topic: str, on_scan: Callable[[LaserScan], None]) -> None:
        """Subscribe to a topic and call `on_scan` with each scan."""
        self.lost = 0
        self._node = node
        self._topic = topic
        self._on_scan = on_scan
        self._subscribe(LOSSLESS)

    def _subscribe(self, qos: QoSProfile) -> None:
        events = SubscriptionEventCallbacks(message_lost=self._on_lost, incompatible_qos=self._on_incompatible)
        self._subscription = self._node.create_subscription(
            LaserScan, self._topic, self._on_scan, qos, event_callbacks=events
        )

    def _on_incompatible(self, _: QoSRequestedIncompatibleQoSInfo) -> None:
        """Subscribe again with best effort: a publisher does not offer reliable delivery."""
        if self._subscription.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT:
            return
        self._node.get_logger().info(
            f"the publisher of {self._topic} offers best effort only: scans may be lost on the way"
        )
        self._node.destroy_subscription(self._subscription)
        self._subscribe(BEST_EFFORT)

    def _on_lost(self, info: QoSMessageLostInfo) -> None:
        before, self.lost = self.lost, self.lost + info.total_count_change
        if before // LOG_EVERY != self.lost // LOG_EVERY or not before:
            self._node.get_logger().warning(f"{self.lost} scans were dropped: they arrive faster than they are mapped")


class Transforms:
    """Transforms from `/tf` and `/tf_static`: the odometry (odom to base frame) and the mounting of the laser."""

    def __init__(
        self, node: Node, odom_frame: str, base_frame: str, on_odometry: Callable[[Time, Pose], None] | None
    ) -> None:
        """Subscribe to static transforms, and to odometry unless `on_odometry` is None."""
        self._odom, self._base = odom_frame, base_frame
        self._on_odometry = on_odometry
        self._fixed: dict[str, tuple[str, Pose]] = {}  # parent frame and pose in it, by child frame
        if TFMessage is None:
            return
        node.create_subscription(TFMessage, "/tf_static", self._on_static, STATIC_TRANSFORMS)
        if on_odometry is not None:
            node.create_subscription(TFMessage, "/tf", self._on_moving, 100)

    def lookup(self, frame: str) -> Pose:
        """Return the pose in the plane of a frame on the robot, in the base frame; the origin if it is unknown."""
        frame = frame.lstrip("/")
        pose = ORIGIN
        for _ in range(len(self._fixed)):
            if frame == self._base or frame not in self._fixed:
                break
            frame, within = self._fixed[frame]
            pose = within @ pose
        return pose if frame == self._base else ORIGIN

    def _on_static(self, message: Any) -> None:
        for each in message.transforms:
            self._fixed[each.child_frame_id.lstrip("/")] = each.header.frame_id.lstrip("/"), _planar_pose(each)

    def _on_moving(self, message: Any) -> None:
        for each in message.transforms:
            ends = each.header.frame_id.lstrip("/"), each.child_frame_id.lstrip("/")
            if ends == (self._odom, self._base) and self._on_odometry is not None:
                self._on_odometry(each.header.stamp, _planar_pose(each))


def subscribe_to_odometry(node: Node, topic: str, on_odometry: Callable[[Time, Pose], None]) -> None:
    """Subscribe to a topic of odometry and call `on_odometry` with the stamp and the pose of each message."""

    def on_message(message: Odometry) -> None:
        on_odometry(message.header.stamp, messages.pose_from(message))

    node.create_subscription(Odometry, topic, on_message, LOSSLESS)


def _planar_pose(transform: TransformStamped) -> Pose:
    """Project a transform onto the plane."""
    place, turn = transform.transform.translation, transform.transform.rotation
    return Pose(place.x, place.y, messages.yaw_of(turn))
