"""Camera: its matrix, and images without its distortion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Picture = NDArray[np.uint8]  # (height, width) grey, or (height, width, 3) red, green, blue


@dataclass(frozen=True, eq=False)
class Camera:
    """Pinhole camera.

    Attributes:
        matrix: (3, 3) from points in the frame of the camera to homogeneous pixels.
        distortion: Coefficients of OpenCV's models, which are those of `sensor_msgs/CameraInfo`; empty for none.
    """

    matrix: Floats
    distortion: tuple[float, ...] = ()

    def rectify(self, picture: Picture) -> Picture:
        """Return an image as a camera with the same matrix and without distortion sees it."""
        if not any(self.distortion):
            return picture
        return np.asarray(cv2.undistort(picture, self.matrix, np.array(self.distortion)), np.uint8)


def grey(picture: Picture) -> Picture:
    """Return a grey image of colours."""
    return picture if picture.ndim == 2 else np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), np.uint8)


def project(points: Floats, rotation: Any, translation: Any, camera: Camera) -> tuple[Floats, Floats]:
    """Project points of an object.

    Args:
        points: (n, 3), metres, frame of the object.
        rotation: Rotation vector (3,) of the object in the frame of the camera.
        translation: (3,), metres.
        camera: Camera, without its distortion.

    Returns:
        Pixels (n, 2), and their derivatives (2n, 6) by rotation and translation.
    """
    pixels, derivatives = cv2.projectPoints(points, rotation, translation, camera.matrix, np.zeros(4))
    return np.asarray(pixels, np.float64).reshape(-1, 2), np.asarray(derivatives[:, :6], np.float64)
