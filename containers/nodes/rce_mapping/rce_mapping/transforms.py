"""The correction of the odometry as a transform, where tf2_msgs is installed."""

from __future__ import annotations

import math

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node

from rce.mapping.geometry import Pose

from .optional import TFMessage


class TransformSender:
    """Sends map to odom, or map to the robot itself where a scan has no odometry. Does nothing without tf2_msgs."""

    def __init__(self, node: Node, map_frame: str, odom_frame: str, base_frame: str) -> None:
        self._out = node.create_publisher(TFMessage, "/tf", 100) if TFMessage else None
        self._map, self._odom, self._base = map_frame, odom_frame, base_frame

    def send(self, stamp: Time, pose: Pose, odometry: Pose | None) -> None:
        """`pose` of the robot in the map frame and in that of the odometry, at `stamp`."""
        if self._out is None:
            return
        child, place = (self._base, pose) if odometry is None else (self._odom, pose @ odometry.inverse())
        message = TransformStamped()
        message.header.stamp, message.header.frame_id, message.child_frame_id = stamp, self._map, child
        message.transform.translation.x, message.transform.translation.y = place.x, place.y
        message.transform.rotation.z, message.transform.rotation.w = (
            math.sin(place.theta / 2),
            math.cos(place.theta / 2),
        )
        self._out.publish(TFMessage(transforms=[message]))
