"""Publication of a camera's pose as a transform, if tf2_msgs is installed."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from rce_mapping.optional import TFMessage
from rclpy.node import Node

from rce.mapping3d.poses import Pose, to_quaternion


class CameraTransform:
    """Publisher of the transform from a map to a camera on `/tf`. It does nothing if tf2_msgs is not installed."""

    def __init__(self, node: Node, camera_frame: str) -> None:
        """Publish the pose of this frame."""
        self._out = node.create_publisher(TFMessage, "/tf", 100) if TFMessage else None
        self._camera_frame = camera_frame

    def send(self, stamp: Time, frame: str, pose: Pose) -> None:
        """Publish the pose (4, 4) of the camera in a frame."""
        if self._out is None:
            return
        message = TransformStamped(child_frame_id=self._camera_frame)
        message.header.stamp, message.header.frame_id = stamp, frame
        place, turn = message.transform.translation, message.transform.rotation
        place.x, place.y, place.z = pose[:3, 3].tolist()
        turn.x, turn.y, turn.z, turn.w = to_quaternion(pose).tolist()
        self._out.publish(TFMessage(transforms=[message]))
