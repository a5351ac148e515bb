from __future__ import annotations

import numpy as np
import pytest

from rce.mapping3d.offload.follower import PoseFollower
from rce.mapping3d.poses import distance, inverse
from tests.support.key_frames import right


def test_motion_is_followed_without_delay() -> None:
    follower = PoseFollower()
    for stamp in (0.0, 0.1, 0.2):
        np.testing.assert_allclose(follower.move(stamp, right(stamp)), right(stamp))


def test_correction_is_followed_smoothly_and_completely() -> None:
    follower = PoseFollower(seconds=0.5)
    before = follower.move(0.0, right(0.0))
    follower.correct(right(0.3))
    steps = []
    for number in range(1, 60):
        pose = follower.move(number / 30, right(0.3))
        steps.append(distance(inverse(before) @ pose))
        before = pose
    assert max(steps) < 0.03
    np.testing.assert_allclose(before, right(0.3), atol=0.01)


def test_second_correction_begins_where_the_first_has_led() -> None:
    follower = PoseFollower()
    follower.move(0.0, right(0.0))
    follower.correct(right(0.3))
    middle = follower.move(0.5, right(0.3))
    follower.correct(right(-0.1))
    np.testing.assert_allclose(follower.move(0.5, right(-0.1)), middle, atol=1e-9)


def test_robot_that_is_found_elsewhere_is_there_at_once() -> None:
    follower = PoseFollower(jump=1.0)
    follower.correct(right(9.0))
    follower.move(0.0, right(0.0))
    follower.correct(right(5.0))
    assert follower.move(0.0, right(5.0))[0, 3] == pytest.approx(5.0)
