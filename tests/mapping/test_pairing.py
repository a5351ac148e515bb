from __future__ import annotations

import numpy as np
import pytest

from rce.mapping.geometry import Pose
from rce.mapping.pairing import KEPT, OdometryPairing
from rce.mapping.scans import Scan


def scan(stamp: float) -> Scan:
    return Scan(stamp, np.ones(3, np.float32), 0.0, 0.1, 10.0)


def at(x: float) -> Pose:
    return Pose(x, 0.0, 0.0)


@pytest.mark.parametrize("odometry_first", [True, False])
def test_the_very_stamp_wins_in_any_order_of_arrival(odometry_first: bool) -> None:
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


def test_between_two_stamps_odometry_is_interpolated() -> None:
    pairing = OdometryPairing()
    pairing.add_odometry(1.0, at(1))
    pairing.add_scan(scan(1.25))
    assert pairing.ready() == []
    pairing.add_odometry(2.0, at(5))
    assert [s.odometry for s in pairing.ready()] == [at(2)]


def test_scans_keep_their_order_while_one_waits() -> None:
    pairing = OdometryPairing()
    for stamp in (1.0, 2.0, 3.0):
        pairing.add_scan(scan(stamp))
    pairing.add_odometry(2.0, at(2))
    assert [s.stamp for s in pairing.ready()] == [1.0, 2.0]
    assert len(pairing) == 1


def test_flush_takes_what_is_near_and_nothing_else() -> None:
    pairing = OdometryPairing()
    pairing.add_odometry(1.0, at(1))
    pairing.add_scan(scan(1.4))
    pairing.add_scan(scan(1.6))
    assert [s.odometry for s in pairing.flush()] == [at(1), None]


def test_without_odometry_flush_gives_none() -> None:
    pairing = OdometryPairing()
    pairing.add_scan(scan(1.0))
    assert [s.odometry for s in pairing.flush()] == [None]


def test_odometry_that_nobody_asks_for_does_not_pile_up() -> None:
    pairing = OdometryPairing()
    for i in range(3 * KEPT):
        pairing.add_odometry(float(i), at(i))
    pairing.add_scan(scan(3.0 * KEPT - 1))
    assert [s.odometry for s in pairing.ready()] == [at(3 * KEPT - 1)]
    assert len(pairing._stamps) <= 2 * KEPT
