"""Rigid motions as (4, 4) float64 matrices: inverse, quaternions, interpolation, the exponential map."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Pose = NDArray[np.float64]
Floats = NDArray[np.float64]


def make_pose(rotation: ArrayLike, translation: ArrayLike) -> Pose:
    """Return the pose with this rotation matrix (3, 3) and this translation (3,)."""
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = translation
    return pose


def inverse(pose: Pose) -> Pose:
    """Return the inverse of a pose."""
    turned = pose[:3, :3].T
    return make_pose(turned, -turned @ pose[:3, 3])


def rigid(pose: Pose) -> Pose:
    """Return the rigid motion nearest to a product of many, in which errors of rounding have grown."""
    return make_pose(Rotation.from_matrix(pose[:3, :3]).as_matrix(), pose[:3, 3])


def transform(pose: Pose, points: NDArray[np.floating]) -> Floats:
    """Return points (n, 3), moved by a pose."""
    moved: Floats = points @ pose[:3, :3].T + pose[:3, 3]
    return moved


def from_quaternion(translation: ArrayLike, quaternion: ArrayLike) -> Pose:
    """Return the pose with this translation (3,) and this quaternion (4,) x, y, z, w, of any length but 0."""
    return make_pose(Rotation.from_quat(quaternion).as_matrix(), translation)


def to_quaternion(pose: Pose) -> Floats:
    """Return the rotation of a pose as unit quaternion (4,) x, y, z, w with w >= 0."""
    quaternion: Floats = Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True)
    return quaternion


def interpolate(first: Pose, second: Pose, share: float) -> Pose:
    """Return the pose that is this share of the way from the first to the second; below 0 or above 1 it goes on.

    The translation is linear, the rotation goes with constant speed about one axis.
    """
    way = Rotation.from_matrix(first[:3, :3].T @ second[:3, :3]).as_rotvec()
    rotation = first[:3, :3] @ Rotation.from_rotvec(share * way).as_matrix()
    return make_pose(rotation, first[:3, 3] + share * (second[:3, 3] - first[:3, 3]))


def angle(pose: Pose) -> float:
    """Return the angle of the rotation of a pose, radians, 0 to pi."""
    return float(Rotation.from_matrix(pose[:3, :3]).magnitude())


def distance(pose: Pose) -> float:
    """Return the length of the translation of a pose, metres."""
    return float(np.linalg.norm(pose[:3, 3]))
