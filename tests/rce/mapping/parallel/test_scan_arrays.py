"""Tests of scans as arrays."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from rce.errors import InvalidRequest
from rce.mapping.geometry import Pose
from rce.mapping.parallel.scan_arrays import ScanArrays, count_scans, pack_scans, unpack_scans
from rce.mapping.scans import Scan

SCANS = [
    Scan(1.5, np.array([1.0, math.nan, math.inf], np.float32), -1.0, 0.5, 30.0, Pose(1.0, 2.0, 0.5)),
    Scan(2.5, np.array([], np.float32), 0.0, 0.1, 10.0),
    Scan(3.5, np.array([4.0, 5.0], np.float32), -0.5, 1.0, 81.0, Pose(3.0, 4.0, -0.5)),
]


def test_scans_survive_packing() -> None:
    packed = pack_scans(SCANS)
    assert count_scans(packed) == 3
    for before, after in zip(SCANS, unpack_scans(packed), strict=True):
        assert np.array_equal(before.ranges, after.ranges, equal_nan=True)
        assert (before.stamp, before.angle_min, before.angle_increment, before.range_max, before.odometry) == (
            after.stamp,
            after.angle_min,
            after.angle_increment,
            after.range_max,
            after.odometry,
        )


@pytest.mark.parametrize(
    "damage",
    [
        {"stamps": b"123"},
        {"lengths": pack_scans(SCANS[:2]).lengths},
        {"ranges": b""},
        {"odometry": b""},
        {"lengths": np.array([-1, 3, 3], "<i8").tobytes()},
        {"measured": b"\x00"},
    ],
)
def test_damaged_arrays_are_refused(damage: dict[str, bytes]) -> None:
    damaged: ScanArrays = replace(pack_scans(SCANS), **damage)
    with pytest.raises(InvalidRequest, match="damaged"):
        list(unpack_scans(damaged))
