"""Images of plane objects, as a camera sees them."""

from __future__ import annotations

import cv2
import numpy as np

from rce.recognition.camera import Camera, Floats, Picture, project
from rce.recognition.poses import rectangle

WIDTH, HEIGHT = 640, 480  # pixels
CAMERA = Camera(np.array([[600.0, 0.0, 319.5], [0.0, 600.0, 239.5], [0.0, 0.0, 1.0]]))
FACING = np.diag([1.0, -1.0, -1.0])  # rotation of an object whose front faces the camera


def turned(about_x: float, about_y: float, about_z: float = 0.0) -> Floats:
    """Return the rotation (3, 3) of an object that faces the camera, and is turned about its own axes, radians."""
    return np.asarray(FACING @ cv2.Rodrigues(np.array([about_x, about_y, about_z]))[0], np.float64)


def texture(seed: int, width: int = 300, height: int = 200) -> Picture:
    """Return a grey picture full of features."""
    noise = np.random.default_rng(seed).integers(0, 255, (height // 10, width // 10), np.uint8)
    return np.asarray(cv2.resize(noise, (width, height), interpolation=cv2.INTER_NEAREST), np.uint8)


def marker(dictionary: int, number: int, pixels: int = 200) -> Picture:
    """Return the print of a marker, without a white border."""
    return np.asarray(
        cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(dictionary), number, pixels), np.uint8
    )


def view(picture: Picture, width: float, rotation: Floats, translation: Floats, noise: float = 2.0) -> Picture:
    """Return a grey image of a picture of this width, metres, before a light wall.

    Args:
        picture: Grey.
        width: Metres.
        rotation: (3, 3) from the frame of the object to that of the camera.
        translation: (3,) metres.
        noise: Standard deviation of pixels.
    """
    rows, columns = picture.shape
    corners = rectangle(width, width * rows / columns)
    seen, _ = project(corners, cv2.Rodrigues(rotation)[0], translation, CAMERA)
    own = np.array([(-0.5, -0.5), (columns - 0.5, -0.5), (columns - 0.5, rows - 0.5), (-0.5, rows - 0.5)], np.float32)
    placed = cv2.getPerspectiveTransform(own, seen.astype(np.float32))
    scene = cv2.warpPerspective(
        picture, placed, (WIDTH, HEIGHT), flags=cv2.INTER_AREA, borderMode=cv2.BORDER_CONSTANT, borderValue=220
    )
    random = np.random.default_rng(0).normal(0.0, noise, scene.shape)
    return np.asarray(np.clip(scene + random, 0, 255), np.uint8)


def angle_between(first: Floats, second: Floats) -> float:
    """Return the angle between two rotations (3, 3), radians."""
    return float(np.linalg.norm(cv2.Rodrigues(first @ second.T)[0]))
