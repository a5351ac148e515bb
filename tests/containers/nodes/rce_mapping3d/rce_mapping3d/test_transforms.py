"""The pose of a camera in tf."""

# ruff: noqa: E402  (ROS is imported only if it is installed)

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs the extra `ros`")

from builtin_interfaces.msg import Time

from tests.support.key_frames import right


def test_pose_is_sent_as_a_transform(start_ros: Callable[..., None]) -> None:
    from rce_mapping3d.transforms import CameraTransform
    from tf2_msgs.msg import TFMessage

    from tests.support.containers.rgbd_robot import Nodes

    start_ros()
    node = rclpy.create_node("tested")
    sender: Any = CameraTransform(node, "camera")
    nodes = Nodes(node)
    received: list[TFMessage] = []
    nodes.node.create_subscription(TFMessage, "/tf", received.append, 10)
    nodes.until(lambda: sender._out.get_subscription_count() == 1)
    sender.send(Time(sec=3), "map", right(0.5))
    nodes.until(lambda: bool(received))
    (found,) = received[0].transforms
    assert (found.header.frame_id, found.child_frame_id, found.header.stamp.sec) == ("map", "camera", 3)
    assert (found.transform.translation.x, found.transform.rotation.w) == (0.5, 1.0)
    nodes.close()
