"""What a mapper hears: scans, and the odometry from a topic or from tf."""

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

EVERYTHING = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)
AS_IT_COMES = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
STATIC = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
OFTEN = 100  # scans; a loss is logged at the first, and then as often


class ScanInput:
    """A topic of scans: reliable, so that a recording arrives whole; best effort where a driver offers no more.

    What ROS drops before it is taken, because the mapper does not keep up, is counted and logged.
    """

    def __init__(self, node: Node, topic: str, take: Callable[[LaserScan], None]) -> None:
        self.lost = 0
        self._node = node
        self._topic = topic
        self._take = take
        self._subscribe(EVERYTHING)

    def _subscribe(self, qos: QoSProfile) -> None:
        events = SubscriptionEventCallbacks(message_lost=self._on_lost, incompatible_qos=self._on_incompatible)
        self._subscription = self._node.create_subscription(
            LaserScan, self._topic, self._take, qos, event_callbacks=events
        )

    def _on_incompatible(self, _: QoSRequestedIncompatibleQoSInfo) -> None:
        if self._subscription.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT:
            return
        self._node.get_logger().info("scans are offered as best effort only: some may be lost on their way")
        self._node.destroy_subscription(self._subscription)
        self._subscribe(AS_IT_COMES)

    def _on_lost(self, info: QoSMessageLostInfo) -> None:
        before, self.lost = self.lost, self.lost + info.total_count_change
        if before // OFTEN != self.lost // OFTEN or not before:
            self._node.get_logger().warning(f"{self.lost} scans were dropped: they come faster than they are mapped")


class Transforms:
    """What `/tf` and `/tf_static` say: the odometry (odom to base frame), and where the laser is on the robot."""

    def __init__(self, node: Node, odom_frame: str, base_frame: str, take: Callable[[Time, Pose], None] | None) -> None:
        """`take` gets the odometry with its stamp; None if it is not wanted."""
        self._odom, self._base = odom_frame, base_frame
        self._take = take
        self._fixed: dict[str, tuple[str, Pose]] = {}  # parent frame and place in it, by child frame
        if TFMessage is None:
            return
        node.create_subscription(TFMessage, "/tf_static", self._on_static, STATIC)
        if take is not None:
            node.create_subscription(TFMessage, "/tf", self._on_moving, 100)

    def place(self, frame: str) -> Pose:
        """Of a frame on the robot, in the base frame, as far as it is flat; the base's own for one that is unknown."""
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
            self._fixed[each.child_frame_id.lstrip("/")] = each.header.frame_id.lstrip("/"), _flat(each)

    def _on_moving(self, message: Any) -> None:
        for each in message.transforms:
            ends = each.header.frame_id.lstrip("/"), each.child_frame_id.lstrip("/")
            if ends == (self._odom, self._base) and self._take is not None:
                self._take(each.header.stamp, _flat(each))


def listen_to_odometry(node: Node, topic: str, take: Callable[[Time, Pose], None]) -> None:
    """The odometry as a topic of its own."""

    def on_odometry(message: Odometry) -> None:
        take(message.header.stamp, messages.pose_from(message))

    node.create_subscription(Odometry, topic, on_odometry, EVERYTHING)


def _flat(transform: TransformStamped) -> Pose:
    place, turn = transform.transform.translation, transform.transform.rotation
    return Pose(place.x, place.y, messages.yaw_of(turn))
