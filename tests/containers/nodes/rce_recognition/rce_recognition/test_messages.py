"""Conversion of messages; detections are tested in test_node.py."""

from __future__ import annotations

import numpy as np
import pytest

from rce.recognition.network import Box


def test_camera_is_that_of_camera_info(interfaces: None) -> None:
    from rce_recognition.messages import camera_of
    from sensor_msgs.msg import CameraInfo

    assert camera_of(CameraInfo()) is None
    info = CameraInfo(k=[600.0, 0.0, 320.0, 0.0, 610.0, 240.0, 0.0, 0.0, 1.0], d=[0.1, 0.0, 0.0, 0.0, 0.0])
    camera = camera_of(info)
    assert camera is not None
    assert (camera.matrix[1, 1], camera.distortion[0]) == (610.0, 0.1)


def test_box_has_its_centre_and_size(interfaces: None) -> None:
    from rce_recognition.messages import boxes_message
    from std_msgs.msg import Header

    message = boxes_message([Box("cup", 0.9, np.array([10.0, 20.0, 30.0, 60.0]))], Header(frame_id="camera"))
    (found,) = message.detections
    assert (found.results[0].hypothesis.class_id, found.results[0].hypothesis.score) == ("cup", 0.9)
    assert (found.bbox.center.position.x, found.bbox.center.position.y) == (20.0, 40.0)
    assert (found.bbox.size_x, found.bbox.size_y) == pytest.approx((20.0, 40.0))
    assert found.header.frame_id == "camera"
