from __future__ import annotations

import math

import numpy as np
import pytest

from rce.mapping.geometry import ORIGIN, Pose, interpolate, wrap_angle


def test_pose_and_its_inverse_cancel() -> None:
    pose = Pose(3.0, -2.0, 2.5)
    assert pose @ pose.inverse() == pytest.approx(ORIGIN)
    assert pose.to(pose @ Pose(1.0, 0.5, -3.0)) == pytest.approx((1.0, 0.5, -3.0))


def test_quarter_turn_rotates_forward_to_left() -> None:
    moved = Pose(1.0, 2.0, math.pi / 2).transform(np.array([[1.0, 0.0], [0.0, 1.0]]))
    np.testing.assert_allclose(moved, [[1.0, 3.0], [0.0, 2.0]], atol=1e-12)


@pytest.mark.parametrize(("angle", "wrapped"), [(math.pi, -math.pi), (-math.pi, -math.pi), (7.0, 7.0 - 2 * math.pi)])
def test_angles_are_wrapped(angle: float, wrapped: float) -> None:
    assert wrap_angle(angle) == pytest.approx(wrapped)


def test_interpolation_turns_the_shorter_way() -> None:
    middle = interpolate(Pose(0.0, 0.0, math.pi - 0.1), Pose(2.0, 4.0, -math.pi + 0.3), 0.5)
    assert middle == pytest.approx((1.0, 2.0, -math.pi + 0.1))
