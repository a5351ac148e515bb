"""Pose of a plane object from corresponding points, with its covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from rce.recognition.camera import Camera, Floats, project

PIXEL = 0.3  # pixels; standard deviation of a point, if the residuals do not say more
INDEPENDENT = 12  # points; errors of more are not independent, as neighbours are drawn and smoothed alike
AMBIGUOUS = 1.5  # a second solution whose error is less than so many times that of the first may be the right one


@dataclass(frozen=True, eq=False)
class ObjectPose:
    """Pose of an object in the frame of the camera.

    Attributes:
        rotation: (3, 3) from the frame of the object.
        translation: (3,) metres.
        covariance: (6, 6) of x, y, z and of rotations about these axes, frame of the camera, metres and radians.
        error: Root of the mean square of the distances of the points from where they should be, pixels.
    """

    rotation: Floats
    translation: Floats
    covariance: Floats
    error: float

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """The rotation as x, y, z, w."""
        vector = cv2.Rodrigues(self.rotation)[0].ravel()
        angle = float(np.linalg.norm(vector))
        axis = vector / angle if angle else vector
        x, y, z = (axis * math.sin(angle / 2)).tolist()
        return x, y, z, math.cos(angle / 2)


def rectangle(width: float, height: float) -> Floats:
    """Return the corners (4, 3) of a rectangle around the origin, clockwise for its viewer from the upper left."""
    x, y = width / 2, height / 2
    return np.array([(-x, y, 0.0), (x, y, 0.0), (x, -y, 0.0), (-x, -y, 0.0)])


def find_pose(points: Floats, pixels: Floats, camera: Camera) -> ObjectPose | None:
    """Return the pose of an object; None if the points do not determine one.

    Starts with IPPE (Collins and Bartoli, Infinitesimal Plane-Based Pose Estimation, 2014), which gives two solutions,
    and refines the better one. The covariance is that of the least squares, with the noise that the residuals show, of
    INDEPENDENT points at most. If the other solution fits nearly as well, the difference of the two rotations is added.

    Args:
        points: (n, 3) of the plane z = 0, metres, frame of the object; 4 or more.
        pixels: (n, 2) where they are seen, without distortion.
        camera: The camera.
    """
    given = np.ascontiguousarray(points), np.ascontiguousarray(pixels, np.float64)
    try:
        count, rotations, translations, errors = cv2.solvePnPGeneric(
            *given, camera.matrix, np.zeros(4), flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:  # points on a line
        return None
    off: list[float] = np.asarray(errors, np.float64).ravel().tolist()
    if not count or not all(map(math.isfinite, off)):
        return None
    vector, translation = cv2.solvePnPRefineLM(
        *given, camera.matrix, np.zeros(4), rotations[0].copy(), translations[0].copy()
    )
    vector, translation = np.asarray(vector, np.float64).ravel(), np.asarray(translation, np.float64).ravel()
    seen, derivatives = project(given[0], vector, translation, camera)
    residuals = (seen - pixels).ravel()
    noise = max(float(residuals @ residuals) / max(len(residuals) - 6, 1), PIXEL**2)
    information = derivatives.T @ derivatives / noise * min(1.0, INDEPENDENT / len(pixels))
    if translation[2] <= 0 or np.linalg.matrix_rank(information) < 6:
        return None
    covariance = _about_axes(np.asarray(np.linalg.inv(information), np.float64), vector)
    if count > 1 and off[1] < AMBIGUOUS * max(off[0], PIXEL):
        other = cv2.Rodrigues(cv2.Rodrigues(rotations[1])[0] @ cv2.Rodrigues(vector)[0].T)[0].ravel()
        covariance[3:, 3:] += np.outer(other, other) / 2
    rotation = np.asarray(cv2.Rodrigues(vector)[0], np.float64)
    error = math.sqrt(float(residuals @ residuals) / len(pixels))
    return ObjectPose(rotation, translation, covariance, error)


def _about_axes(covariance: Floats, vector: Floats) -> Floats:
    """Return a covariance of rotation vector and translation as one of translation and rotations about fixed axes.

    A small change of a rotation vector is a rotation by the left Jacobian of SO(3) times the change.
    """
    angle = float(np.linalg.norm(vector))
    left = np.eye(3)
    if angle > 1e-9:
        x, y, z = vector / angle
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        part = math.sin(angle) / angle
        axis = np.outer(vector, vector) / angle**2
        left = part * np.eye(3) + (1 - part) * axis + (1 - math.cos(angle)) / angle * cross
    change = np.zeros((6, 6))
    change[:3, 3:], change[3:, :3] = np.eye(3), left
    return np.asarray(change @ covariance @ change.T, np.float64)
