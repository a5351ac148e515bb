"""Images of a camera: colour, depth and camera_info, raw or compressed, paired by their stamps."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from rce.errors import RceError
from rce.mapping3d.camera import Camera
from rce.mapping3d.files.recordings.bags import MAX_WAITING, MILLIMETRES, color_image, depth_image, paired
from rce.mapping3d.files.recordings.images import Undistortion, checked
from rce.mapping3d.frames import RgbdFrame, reduced

from . import messages

NEWEST = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)  # cameras are faster than what falls behind


class ImageInput:
    """Topics `image_raw`, `image_raw/compressed` of `camera/color` and `camera/depth`; `camera/color/camera_info`.

    Depths are registered to the colours: integers in millimetres, or floats in metres (REP 118).
    """

    def __init__(self, node: Node, prefix: str, on_frame: Callable[[RgbdFrame, Camera], None]) -> None:
        """Subscribe; call `on_frame` with each frame, reduced for the front end, and the camera before that."""
        self._node, self._on_frame = node, on_frame
        self._colors: deque[tuple[float, Any]] = deque(maxlen=MAX_WAITING)
        self._depths: deque[tuple[float, Any]] = deque(maxlen=MAX_WAITING)
        self._camera: Camera | None = None
        self._undistort: Undistortion | None = None
        self._last = -np.inf
        for kind, ending in ((Image, ""), (CompressedImage, "/compressed")):
            node.create_subscription(kind, f"{prefix}camera/color/image_raw{ending}", self._on_color, NEWEST)
            node.create_subscription(kind, f"{prefix}camera/depth/image_raw{ending}", self._on_depth, NEWEST)
        node.create_subscription(CameraInfo, f"{prefix}camera/color/camera_info", self._on_info, NEWEST)

    def _on_info(self, message: CameraInfo) -> None:
        fx, _, cx, _, fy, cy = (float(value) for value in message.k[:6])
        camera = Camera(message.width, message.height, fx, fy, cx, cy)
        if camera != self._camera and fx > 0 and fy > 0:
            self._camera = camera
            self._undistort = Undistortion(camera, list(message.d)[:8]) if any(message.d) else None

    def _on_color(self, message: Any) -> None:
        self._take(lambda: self._colors.append((messages.seconds(message.header.stamp), color_image(message))))

    def _on_depth(self, message: Any) -> None:
        self._take(
            lambda: self._depths.append((messages.seconds(message.header.stamp), depth_image(message, MILLIMETRES)))
        )

    def _take(self, action: Callable[[], None]) -> None:
        """Take an image and answer the frames that are complete now. A damaged image is logged."""
        try:
            action()
            if self._camera is None:
                return
            for frame in paired(self._colors, self._depths):
                if frame.stamp > self._last:
                    self._last = frame.stamp
                    checked(frame, self._camera, "the camera")
                    self._on_frame(reduced(self._undistort(frame) if self._undistort else frame), self._camera)
        except RceError as error:
            self._node.get_logger().warning(str(error), throttle_duration_sec=5.0)
