"""Publication of the odometry correction as a transform, if tf2_msgs is installed."""

from __future__ import annotations

import math

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node

from rce.mapping.geometry import Pose

from .optional import TFMessage


class TransformSender:
    """Publisher of map to odom, or of map to the base frame for a scan without odometry.

    It does nothing if tf2_msgs is not installed.
    """

    def __init__(self, node: Node, map_frame: str, odom_frame: str, base_frame: str) -> None:
        """Publish on `/tf` with these frames."""
        self._out = node.create_publisher(TFMessage, "/tf", 100) if TFMessage else None
        self._map, self._odom, self._base = map_frame, odom_frame, base_frame

    def send(self, stamp: Time, pose: Pose, odometry: Pose | None) -> None:
        """Publish the transform at a stamp.

        Args:
            stamp: Stamp of the scan.
            pose: Pose of the robot in the map frame.
            odometry: Pose of the robot in the odometry frame; None if the scan has no odometry.
        """
        if self._out is None:
            return
        child, offset = (self._base, pose) if odometry is None else (self._odom, pose @ odometry.inverse())
        message = TransformStamped()
        message.header.stamp, message.header.frame_id, message.child_frame_id = stamp, self._map, child
        message.transform.translation.x, message.transform.translation.y = offset.x, offset.y
        message.transform.rotation.z, message.transform.rotation.w = (
            math.sin(offset.theta / 2),
            math.cos(offset.theta / 2),
        )
        self._out.publish(TFMessage(transforms=[message]))
