"""ROS 2 node `recogniser`: recognises fiducials, textured objects, and what a user's network finds.

Subscriptions: `image_raw`, `image_raw/compressed` and `camera_info`. Publications: `detections`
(vision_msgs/Detection3DArray), with poses in the frame of the camera and their covariances, one message for each image
that was looked at; with a network `detections_2d` (vision_msgs/Detection2DArray), too. Images that come meanwhile are
skipped.
"""

from __future__ import annotations

from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from vision_msgs.msg import Detection2DArray, Detection3DArray

from rce.client.environment_knowledge import EnvironmentKnowledge
from rce.errors import RceError
from rce.mapping3d.files.recordings.bags import color_image
from rce.recognition.camera import Camera
from rce.recognition.network import Network
from rce.recognition.recogniser import Recogniser

from .messages import boxes_message, camera_of, detections_message
from .parameters import network_of, settings_of

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)  # cameras are faster than recognition
PATIENCE = 5.0  # seconds between two messages of the same kind in the log


class RecogniserNode(Node):
    """Node around a `Recogniser` and a `Network`."""

    def __init__(self, knowledge: EnvironmentKnowledge | None = None) -> None:
        """Load the models; `knowledge` is the client of the repository, by default that of the environment."""
        super().__init__("recogniser")
        self._recogniser = Recogniser(settings_of(self, knowledge))
        network = network_of(self)
        self._network = Network(*network) if network else None
        self._camera: Camera | None = None
        self._out = self.create_publisher(Detection3DArray, "detections", 10)
        self._boxes_out = self.create_publisher(Detection2DArray, "detections_2d", 10) if self._network else None
        self.create_subscription(CameraInfo, "camera_info", self._on_info, NEWEST)
        self.create_subscription(Image, "image_raw", self._on_image, NEWEST)
        self.create_subscription(CompressedImage, "image_raw/compressed", self._on_image, NEWEST)

    def _on_info(self, message: CameraInfo) -> None:
        self._camera = camera_of(message)

    def _on_image(self, message: Any) -> None:
        """Recognise what is in an image. One that cannot be read is logged."""
        try:
            picture = color_image(message)
            if self._camera is None:
                self._warn("images come without a calibrated camera_info: nothing but boxes is recognised")
            else:
                found = self._recogniser.find(self._camera.rectify(picture), self._camera)
                self._out.publish(detections_message(found, message.header))
            if self._network is not None and self._boxes_out is not None:
                self._boxes_out.publish(boxes_message(self._network.find(picture), message.header))
        except RceError as error:
            self._warn(str(error))

    def _warn(self, words: str) -> None:
        self.get_logger().warning(words, throttle_duration_sec=PATIENCE)
