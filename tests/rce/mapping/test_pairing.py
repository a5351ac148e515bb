from __future__ import annotations

import numpy as np
import pytest

from rce.mapping.geometry import Pose
from rce.mapping.pairing import MAX_ODOMETRY, OdometryPairing
from rce.mapping.scans import Scan


def scan(stamp: float) -> Scan:
    return Scan(stamp, np.ones(3, np.float32), 0.0, 0.1, 10.0)


def at(x: float) -> Pose:
    return Pose(x, 0.0, 0.0)


@pytest.mark.parametrize("odometry_first", [True, False])
def test_odometry_of_the_same_stamp_is_used_in_any_order_of_arrival(odometry_first: bool) -> None:
    pairing = OdometryPairing()
    pairing.add_odometry(1.0, at(1))
    if odometry_first:
        pairing.add_odometry(2.0, at(7))
    pairing.add_scan(scan(2.0))
    if not odometry_first:
        assert pairing.ready() == []
        pairing.add_odometry(2.0, at(7))
    assert [s.odometry for s in pairing.ready()] == [at(7)]
    assert len(pairing) == 0


def test_odometry_between_two_stamps_is_interpolated() -> None:
    pairing = OdometryPairing()
    pairing.add_odometry(1.0, at(1))
    pairing.add_scan(scan(1.25))
    assert pairing.ready() == []
    pairing.add_odometry(2.0, at(5))
    assert [s.odometry for s in pairing.ready()] == [at(2)]


def test_scans_keep_their_order_while_waiting() -> None:
    pairing = OdometryPairing()
    for stamp in (1.0, 2.0, 3.0):
        pairing.add_scan(scan(stamp))
    pairing.add_odometry(2.0, at(2))
    assert [s.stamp for s in pairing.ready()] == [1.0, 2.0]
    assert len(pairing) == 1


def test_flush_uses_only_odometry_near_by() -> None:
    pairing = OdometryPairing()
    pairing.add_odometry(1.0, at(1))
    pairing.add_scan(scan(1.4))
    pairing.add_scan(scan(1.6))
    assert [s.odometry for s in pairing.flush()] == [at(1), None]


def test_flush_without_odometry_pairs_none() -> None:
    pairing = OdometryPairing()
    pairing.add_scan(scan(1.0))
    assert [s.odometry for s in pairing.flush()] == [None]


def test_unused_odometry_is_bounded() -> None:
    pairing = OdometryPairing()
    for i in range(3 * MAX_ODOMETRY):
        pairing.add_odometry(float(i), at(i))
    pairing.add_scan(scan(3.0 * MAX_ODOMETRY - 1))
    assert [s.odometry for s in pairing.ready()] == [at(3 * MAX_ODOMETRY - 1)]
    assert len(pairing._stamps) <= 2 * MAX_ODOMETRY
