from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rce.mapping3d import poses

POSE = poses.make_pose(Rotation.from_euler("xyz", (0.3, -0.8, 2.0)).as_matrix(), (1.0, -2.0, 0.5))


def test_pose_times_its_inverse_is_identity() -> None:
    np.testing.assert_allclose(POSE @ poses.inverse(POSE), np.eye(4), atol=1e-12)


def test_pose_is_the_same_after_a_round_trip_by_quaternion() -> None:
    again = poses.from_quaternion(POSE[:3, 3], poses.to_quaternion(POSE))
    np.testing.assert_allclose(again, POSE, atol=1e-12)


def test_half_way_between_poses_turns_by_half_the_angle() -> None:
    turned = poses.make_pose(Rotation.from_rotvec((0.0, 1.0, 0.0)).as_matrix(), (2.0, 0.0, 0.0))
    middle = poses.interpolate(np.eye(4), turned, 0.5)
    assert poses.angle(middle) == pytest.approx(0.5)
    assert poses.distance(middle) == pytest.approx(1.0)
    np.testing.assert_allclose(poses.interpolate(POSE, turned, 1.0), turned, atol=1e-12)


def test_angle_is_exact_for_half_turns() -> None:
    assert poses.angle(np.diag([1.0, -1.0, -1.0, 1.0])) == pytest.approx(math.pi)


def test_transform_moves_points() -> None:
    moved = poses.transform(POSE, np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    np.testing.assert_allclose(moved, [POSE[:3, 3], POSE[:3, 3] + POSE[:3, 0]])
