"""ROS 2 node `tracker`: the front end, for robots that run ROS 2.

Subscriptions: images as in `images`, `pose` and `corrections` of a mapper. Publications: `key_frames` for a mapper,
`camera_pose` (the pose of each frame, which follows corrections without jumps) and tf. A key frame is sent again until
the mapper answers it.
"""

from __future__ import annotations

import time

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Path
from rce_mapping.inputs import LOSSLESS
from rce_mapping.parameters import text
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage

from rce.mapping3d.camera import Camera
from rce.mapping3d.frames import RgbdFrame, reduced_camera
from rce.mapping3d.offload.sending import Sending
from rce.mapping3d.offload.tracking import RobotTracking
from rce.mapping3d.poses import from_quaternion

from . import messages
from .images import ImageInput
from .transforms import CameraTransform

INTERVAL = 0.05  # seconds between attempts to send


class TrackerNode(Node):
    """Node around a `RobotTracking`."""

    def __init__(self) -> None:
        """Create the topics. Tracking begins with the first frame."""
        super().__init__("tracker")
        described = ParameterDescriptor(description="Frame of the camera in tf.", read_only=True)
        self.declare_parameter("camera_frame", "camera_optical_frame", described)
        self._tracking: RobotTracking | None = None
        self._camera: Camera | None = None
        self._sending = Sending()
        self._transform = CameraTransform(self, text(self, "camera_frame"))
        self._pose_out = self.create_publisher(PoseStamped, "camera_pose", 10)
        self._key_frames_out = self.create_publisher(CompressedImage, "key_frames", LOSSLESS)
        self._images = ImageInput(self, "", self._on_frame)
        self.create_subscription(PoseWithCovarianceStamped, "pose", self._on_answer, LOSSLESS)
        self.create_subscription(Path, "corrections", self._on_corrections, LOSSLESS)
        self.create_timer(INTERVAL, self._send)

    def _on_frame(self, frame: RgbdFrame, camera: Camera) -> None:
        if self._tracking is None or self._camera != camera:
            self._tracking, self._camera, self._sending = RobotTracking(reduced_camera(camera)), camera, Sending()
        located = self._tracking.add(frame)
        message = PoseStamped()
        message.header.stamp, message.header.frame_id = messages.stamp_of(frame.stamp), located.map
        messages.fill_pose(message.pose, located.pose)
        self._pose_out.publish(message)
        self._transform.send(message.header.stamp, located.map, located.pose)
        self._send()

    def _send(self) -> None:
        if self._tracking is None or not self._key_frames_out.get_subscription_count():
            return
        for stamp, format, data in self._sending.due(self._tracking.outbox, time.monotonic()):
            self._key_frames_out.publish(messages.compressed_message(stamp, "camera", format, data))

    def _on_answer(self, message: PoseWithCovarianceStamped) -> None:
        if self._tracking is not None:
            self._sending.answered(self._tracking.outbox, messages.microseconds(message.header.stamp), time.monotonic())

    def _on_corrections(self, message: Path) -> None:
        if self._tracking is not None:
            told = {
                messages.microseconds(each.header.stamp): (
                    from_quaternion(*messages.pose_from(each.pose)),
                    each.header.frame_id,
                )
                for each in message.poses
            }
            self._tracking.correct(told)
