"""Images of a camera."""

# ruff: noqa: E402  (ROS is imported only if it is installed)

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs the extra `ros`")

from rce.mapping3d.camera import Camera
from rce.mapping3d.evaluation.room import QVGA
from rce.mapping3d.frames import RgbdFrame
from tests.support.rgbd import CLEAN, simulated


def test_colour_and_depth_of_one_moment_become_a_frame(start_ros: Callable[..., None]) -> None:
    from rce_mapping3d.images import ImageInput

    from tests.support.containers.rgbd_robot import Nodes, image

    start_ros()
    found: list[tuple[RgbdFrame, Camera]] = []
    node = rclpy.create_node("tested")
    images = ImageInput(node, "", lambda frame, camera: found.append((frame, camera)))
    nodes = Nodes(node)
    nodes.until(lambda: all(topic.get_subscription_count() for topic in (nodes.color, nodes.depth, nodes.info)))
    first, second = list(simulated(0.1, faults=CLEAN))[:2]
    nodes.send_camera(QVGA)
    nodes.until(lambda: images._camera is not None)
    nodes.color.publish(image(first, "unknown", first.color))
    nodes.send_images(second)
    nodes.until(lambda: len(found) == 1)
    assert found[0][1] == QVGA
    assert found[0][0].stamp == pytest.approx(second.stamp, abs=1e-6)
    np.testing.assert_allclose(found[0][0].depth, second.depth, atol=0.00051)
    np.testing.assert_array_equal(found[0][0].color, second.color)
    nodes.close()
