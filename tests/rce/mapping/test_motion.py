from __future__ import annotations

import math

import numpy as np
import pytest

from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.motion import Motion
from rce.mapping.scans import Scan


def scan(stamp: float, odometry: Pose | None) -> Scan:
    return Scan(stamp, np.empty(0, np.float32), 0.0, 0.01, 10.0, odometry)


def driven(odometry: list[Pose | None]) -> Motion:
    """Return the motion model of a robot that has moved 0.1 m a scan."""
    motion = Motion()
    for i, wheels in enumerate(odometry):
        motion.update(scan(0.1 * i, wheels), Pose(0.1 * i, 0.0, 0.0))
    return motion


def test_first_scan_is_at_the_origin() -> None:
    assert Motion().predict(scan(0.0, Pose(5.0, 5.0, 5.0))) == [ORIGIN]


def test_odometry_is_predicted_before_the_repeated_motion() -> None:
    predictions = driven([Pose(1.0, 1.0, 0.0), Pose(1.1, 1.0, 0.0)]).predict(scan(0.2, Pose(1.4, 1.0, 0.2)))
    assert predictions == [pytest.approx((0.4, 0.0, 0.2)), pytest.approx((0.2, 0.0, 0.0))]


def test_motion_is_not_repeated_after_a_pause() -> None:
    assert len(driven([ORIGIN, Pose(0.1, 0.0, 0.0)]).predict(scan(5.0, Pose(0.1, 0.0, 0.0)))) == 1


@pytest.mark.parametrize("odometry", [None, Pose(1e9, 0.0, 0.0), Pose(math.nan, 0.0, 0.0)], ids=["none", "far", "nan"])
def test_last_motion_is_repeated_without_plausible_odometry(odometry: Pose | None) -> None:
    motion = driven([ORIGIN, Pose(0.1, 0.0, 0.0)])
    assert motion.predict(scan(0.2, odometry)) == [pytest.approx((0.2, 0.0, 0.0))]


def test_correction_moves_the_pose_of_the_last_odometry() -> None:
    motion = driven([ORIGIN, Pose(0.1, 0.0, 0.0), None])
    motion.correct(Pose(5.0, 5.0, math.pi / 2))
    first, second = motion.predict(scan(0.3, Pose(0.3, 0.0, 0.0)))
    assert first == pytest.approx((5.0, 5.1, math.pi / 2)), (
        "the last odometry was 0.1 m behind the pose, and the wheels have moved 0.2 m since"
    )
    assert second == pytest.approx((5.0, 5.1, math.pi / 2))


@pytest.mark.parametrize(
    ("stamps", "known"), [((0.0, 0.2, 0.4), True), ((0.0, 2.0, 2.2), False), ((0.0, 0.2, 2.2), False)]
)
def test_motion_is_predictable_without_odometry_if_two_steps_are_short(
    stamps: tuple[float, float, float], known: bool
) -> None:
    """The motion of two seconds does not predict that of a fifth of a second."""
    motion = Motion()
    for stamp in stamps[:2]:
        motion.update(scan(stamp, None), Pose(stamp, 0.0, 0.0))
    assert math.isfinite(motion.spread(scan(stamps[2], None))) == known


def test_unreliable_pose_does_not_change_the_predicted_motion() -> None:
    motion = driven([None, None])
    motion.update(scan(2.0, None), Pose(-3.0, 0.0, 1.0), reliable=False)
    repeated, stayed = motion.predict(scan(4.0, None))
    assert repeated == pytest.approx(Pose(-3.0, 0.0, 1.0) @ Pose(0.1, 0.0, 0.0))
    assert stayed == Pose(-3.0, 0.0, 1.0)


def test_lengths_by_the_wheels_are_corrected_by_what_was_matched() -> None:
    motion, sure = Motion(), np.diag([1e-6, 1e-6, 1e-6])
    for i in range(60):
        motion.update(scan(0.1 * i, Pose(1.1 * i, 0.0, 0.0)), Pose(1.0 * i, 0.0, 0.0), covariance=sure)
    first, _ = motion.predict(scan(6.0, Pose(1.1 * 61, 0.0, 0.0)))
    assert first == pytest.approx((61.0, 0.0, 0.0), abs=0.03)


def test_poses_that_were_not_matched_do_not_correct_the_wheels() -> None:
    motion = Motion()
    for i in range(60):
        motion.update(scan(0.1 * i, Pose(1.1 * i, 0.0, 0.0)), Pose(1.0 * i, 0.0, 0.0))
    first, _ = motion.predict(scan(6.0, Pose(1.1 * 60, 0.0, 0.0)))
    assert first == pytest.approx((59.0 + 1.1, 0.0, 0.0))
