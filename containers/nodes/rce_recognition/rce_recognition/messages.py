"""Conversion between ROS messages and the types of `rce.recognition`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from sensor_msgs.msg import CameraInfo
from vision_msgs.msg import Detection2D, Detection2DArray, Detection3D, Detection3DArray, ObjectHypothesisWithPose

from rce.recognition.camera import Camera
from rce.recognition.network import Box
from rce.recognition.recogniser import Detection


def camera_of(info: CameraInfo) -> Camera | None:
    """Return the camera of a message; None if it is not calibrated."""
    matrix = np.array(info.k, np.float64).reshape(3, 3)
    return Camera(matrix, tuple(float(each) for each in info.d)) if matrix[0, 0] > 0 else None


def detections_message(found: Sequence[Detection], header: Any) -> Detection3DArray:
    """Convert detections with poses; `header` is that of the image, whose frame is that of the camera."""
    return Detection3DArray(header=header, detections=[_detection(each, header) for each in found])


def boxes_message(found: Sequence[Box], header: Any) -> Detection2DArray:
    """Convert boxes in an image."""
    return Detection2DArray(header=header, detections=[_box(each, header) for each in found])


def _detection(found: Detection, header: Any) -> Detection3D:
    result = _hypothesis(found.name, found.score)
    place, turn = result.pose.pose.position, result.pose.pose.orientation
    place.x, place.y, place.z = found.pose.translation.tolist()
    turn.x, turn.y, turn.z, turn.w = found.pose.quaternion
    result.pose.covariance = found.pose.covariance.ravel()
    message = Detection3D(header=header, results=[result], id=found.name)
    message.bbox.center = result.pose.pose
    message.bbox.size.x, message.bbox.size.y = found.size
    return message


def _box(found: Box, header: Any) -> Detection2D:
    left, upper, right, lower = found.corners.tolist()
    message = Detection2D(header=header, results=[_hypothesis(found.label, found.score)])
    message.bbox.center.position.x, message.bbox.center.position.y = (left + right) / 2, (upper + lower) / 2
    message.bbox.size_x, message.bbox.size_y = right - left, lower - upper
    return message


def _hypothesis(name: str, score: float) -> ObjectHypothesisWithPose:
    result = ObjectHypothesisWithPose()
    result.hypothesis.class_id, result.hypothesis.score = name, score
    return result
