"""Odometry from scans."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.laser_odometry import SETTINGS, LaserOdometry
from rce.mapping.matching import local_map
from rce.mapping.scans import Scan
from rce.mapping.state import Reader, flatten
from tests.support.laser import PLACE, RANGE_MAX, points_at, scan_at

WAY = [PLACE @ Pose(-0.06 * i, 0.0, 0.02 * i) for i in range(20)]  # within the first room


def add(odometry: LaserOdometry, pose: Pose, number: int, wheels: Pose | None = None) -> None:
    scan = scan_at(pose, stamp=0.1 * number, odometry=wheels)
    odometry.add(scan, scan.points(RANGE_MAX))


def driven(wheels: bool = False) -> LaserOdometry:
    odometry = LaserOdometry(RANGE_MAX)
    for number, pose in enumerate(WAY):
        add(odometry, pose, number, WAY[0].to(pose) if wheels else None)
    return odometry


@pytest.mark.parametrize("wheels", [True, False])
def test_motion_is_found(wheels: bool) -> None:
    off = driven(wheels).pose.to(WAY[0].to(WAY[-1]))
    assert math.hypot(off.x, off.y) < 0.02
    assert abs(off.theta) < 0.01


def test_first_scan_is_at_the_origin_and_not_matched() -> None:
    odometry, scan = LaserOdometry(RANGE_MAX), scan_at(PLACE)
    assert odometry.add(scan, scan.points(RANGE_MAX)) is None
    assert (odometry.pose, odometry.wheel_pose, odometry.count) == (ORIGIN, ORIGIN, 1)


def test_unusable_scan_moves_by_the_wheels() -> None:
    odometry = driven(wheels=True)
    before, last = odometry.pose, WAY[0].to(WAY[-1])
    step = Pose(0.1, 0.0, 0.05)
    blind = Scan(2.0, np.empty(0, np.float32), 0.0, 0.1, RANGE_MAX, last @ step)
    assert odometry.add(blind, None) is None
    assert odometry.pose == pytest.approx(before @ odometry._motion._scale.correct(step))


def test_wheels_measure_the_length_and_the_laser_the_turn() -> None:
    """The wheels overestimate the way by a fifth, of which a part is corrected on the way."""
    odometry, wheels = LaserOdometry(RANGE_MAX), ORIGIN
    for number, (before, after) in enumerate(itertools.pairwise([WAY[0], *WAY])):
        step = before.to(after)
        wheels = wheels @ Pose(1.2 * step.x, 1.2 * step.y, 0.0)
        add(odometry, after, number, wheels)
    assert odometry.wheel_pose.theta == pytest.approx(odometry.pose.theta, abs=1e-6)
    way = math.hypot(*odometry.pose[:2])
    assert math.hypot(*odometry.wheel_pose[:2]) == pytest.approx(1.14 * way, rel=0.03)


def test_robot_that_stands_keeps_one_scan() -> None:
    odometry = LaserOdometry(RANGE_MAX)
    for number in range(5):
        add(odometry, PLACE, number)
    assert odometry.count == 1


def test_scans_are_kept_at_a_distance_and_local_points_are_in_the_frame_of_the_robot() -> None:
    odometry = driven()
    assert 3 <= odometry.count <= len(WAY) * 0.07 / SETTINGS.move + 1
    seen, walls = odometry.local_points(), points_at(WAY[-1], beams=3600)
    apart = np.hypot(*(seen[:, None] - walls[None]).transpose(2, 0, 1)).min(axis=1)
    assert np.median(apart) < 0.03
    assert len(odometry.local_points(odometry.count)) == 0
    assert 0 < len(odometry.local_points(odometry.count - 1)) < len(seen)


def test_scans_of_long_ago_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_map, "SETTINGS", local_map.LocalMapSettings(way=0.5))
    odometry = driven()
    assert len(odometry._kept) < odometry.count


def test_restored_odometry_continues_exactly() -> None:
    odometry, other = driven(), LaserOdometry(RANGE_MAX)
    other.restore(Reader(dict(flatten(odometry.state()))))
    for each in (odometry, other):
        add(each, WAY[-1] @ Pose(0.05, 0.01, -0.02), len(WAY))
    assert (odometry.pose, odometry.wheel_pose, odometry.count) == (other.pose, other.wheel_pose, other.count)
    np.testing.assert_array_equal(odometry.local_points(), other.local_points())
