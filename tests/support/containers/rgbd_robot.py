"""Nodes of a robot with a camera beside a node that a test is about, in the process of the test. Needs ROS 2."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid, Path
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import String

from rce.mapping3d.camera import Camera
from rce.mapping3d.frames import RgbdFrame
from tests.support.spin import spin_until


def image(frame: RgbdFrame, encoding: str, pixels: np.ndarray[Any, Any]) -> Image:
    from rce_mapping3d.messages import stamp_of

    height, width = pixels.shape[:2]
    message = Image(height=height, width=width, encoding=encoding, step=pixels.strides[0])
    message.header.stamp = stamp_of(frame.stamp)
    message.data = array("B", np.ascontiguousarray(pixels).tobytes())
    return message


class Nodes:
    """Nodes under test and a node `robot`, on one executor."""

    def __init__(self, *tested: Any, prefix: str = "") -> None:
        from rce_mapping.inputs import LOSSLESS
        from rce_mapping.map_output import LATCHED

        self.tested, self._prefix = tested, prefix
        self.node = rclpy.create_node("robot")
        self.poses: list[PoseWithCovarianceStamped] = []
        self.corrections: list[Path] = []
        self.maps: list[OccupancyGrid] = []
        self.teams: list[String] = []
        make = self.node.create_subscription
        make(PoseWithCovarianceStamped, f"{prefix}pose", self.poses.append, LOSSLESS)
        make(Path, f"{prefix}corrections", self.corrections.append, LOSSLESS)
        make(OccupancyGrid, f"{prefix}map", self.maps.append, LATCHED)
        make(String, f"{prefix}team", self.teams.append, LATCHED)
        publish = self.node.create_publisher
        self.key_frames = publish(CompressedImage, f"{prefix}key_frames", LOSSLESS)
        self.frames = publish(CompressedImage, f"{prefix}frames", LOSSLESS)
        self.color = publish(Image, f"{prefix}camera/color/image_raw", LOSSLESS)
        self.depth = publish(Image, f"{prefix}camera/depth/image_raw", LOSSLESS)
        self.info = publish(CameraInfo, f"{prefix}camera/color/camera_info", LOSSLESS)
        self.executor = SingleThreadedExecutor()
        for node in (*tested, self.node):
            self.executor.add_node(node)

    def until(self, condition: Callable[[], bool]) -> None:
        spin_until(self.executor, condition)

    def until_discovered(self, *topics: Any) -> None:
        """Wait until the robot's topics, and its subscriptions of what is not latched, have their peers."""
        self.until(lambda: all(each.get_subscription_count() for each in topics))
        members = [member for node in self.tested for member in getattr(node, "members", [])]
        own = [member for member in members if self._prefix in ("", f"{member.name}/")]
        self.until(lambda: all(member._pose_out.get_subscription_count() for member in own))

    def send_camera(self, camera: Camera) -> None:
        message = CameraInfo(width=camera.width, height=camera.height)
        message.k = camera.matrix.ravel()
        self.info.publish(message)

    def send_images(self, frame: RgbdFrame) -> None:
        self.color.publish(image(frame, "rgb8", frame.color))
        self.depth.publish(image(frame, "16UC1", np.round(frame.depth * 1000).astype(np.uint16)))

    def call(self, kind: Any, name: str, **fields: Any) -> Any:
        client: Any = self.node.create_client(kind, name)
        self.until(client.service_is_ready)
        answer = client.call_async(kind.Request(**fields))
        self.until(answer.done)
        return answer.result()

    def close(self) -> None:
        self.executor.shutdown()
        for node in (*self.tested, self.node):
            node.destroy_node()
