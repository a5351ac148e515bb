"""The recogniser node and a camera, on one executor."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from rce.recognition.fiducials import DICTIONARIES
from tests.support.onnx_model import write_detector
from tests.support.plane_scenes import CAMERA, marker, turned, view
from tests.support.spin import spin_until

pytest.importorskip("onnxruntime", reason="needs the extra `onnx`")


def test_images_become_detections(start_ros: Callable[..., None], tmp_path: Path) -> None:
    import rclpy
    from rce_recognition.node import RecogniserNode
    from rclpy.executors import SingleThreadedExecutor
    from sensor_msgs.msg import CameraInfo, CompressedImage, Image
    from vision_msgs.msg import Detection2DArray, Detection3DArray

    network = write_detector(tmp_path / "cups.onnx", [(8.0, 12.0, 32.0, 24.0, 1.0, 0.0)], names=["cup"])
    start_ros("dictionaries:=[apriltag_36h11]", "marker_size:=0.2", f"network:={network}")
    node, camera = RecogniserNode(), rclpy.create_node("camera")
    found: list[Any] = []
    boxes: list[Any] = []
    camera.create_subscription(Detection3DArray, "detections", found.append, 10)
    camera.create_subscription(Detection2DArray, "detections_2d", boxes.append, 10)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    executor.add_node(camera)
    spin_until(executor, lambda: node._out.get_subscription_count() == 1)
    spin_until(executor, lambda: node._boxes_out.get_subscription_count() == 1)

    where = np.array([0.1, 0.0, 0.8])
    scene = view(marker(DICTIONARIES["apriltag_36h11"], 4), 0.2, turned(0.3, 0.2), where)
    image = Image(height=480, width=640, encoding="mono8", step=640, data=scene.tobytes())
    image.header.frame_id = "optical"
    node._on_image(image)
    spin_until(executor, lambda: len(boxes) == 1)
    assert not found, "there is no camera_info yet"
    node._on_info(CameraInfo(k=CAMERA.matrix.ravel()))
    node._on_image(image)
    node._on_image(CompressedImage(format="png", data=cv2.imencode(".png", scene)[1].tobytes()))
    node._on_image(Image(encoding="rainbow"))
    spin_until(executor, lambda: len(found) == 2)
    assert found[0].header.frame_id == "optical"
    (seen,) = found[0].detections
    (result,) = seen.results
    assert (seen.id, result.hypothesis.class_id) == ("apriltag_36h11/4", "apriltag_36h11/4")
    place = result.pose.pose.position
    assert (place.x, place.y, place.z) == pytest.approx(tuple(where), abs=0.02)
    covariance = np.array(result.pose.covariance).reshape(6, 6)
    assert (np.linalg.eigvalsh(covariance) > 0).all()
    assert (seen.bbox.size.x, seen.bbox.center.position.z) == (0.2, place.z)
    assert len(found[1].detections) == 1
    assert boxes[0].detections[0].results[0].hypothesis.class_id == "cup"
    executor.shutdown()
    camera.destroy_node()
    node.destroy_node()
