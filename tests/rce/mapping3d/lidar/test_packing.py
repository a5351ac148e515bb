from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping3d.lidar.packing import MOST, STEP, pack_points, unpack_points


def test_points_come_back_to_half_a_step() -> None:
    points = np.random.default_rng(0).uniform(-60, 60, (500, 3)).astype(np.float32)
    packed = pack_points(points)
    again = unpack_points(packed)
    assert again.shape == points.shape
    away = np.linalg.norm(again[:, None] - points[None], axis=2).min(axis=1)
    assert away.max() < STEP
    assert len(packed) < points.nbytes
    assert pack_points(again) == packed, "what is packed again does not drift"


def test_empty_cloud_comes_back() -> None:
    assert unpack_points(pack_points(np.empty((0, 3), np.float32))).shape == (0, 3)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "damaged"),
        (b"\1\0\0\0no zlib", "damaged"),
        (struct.pack("<I", 3) + zlib.compress(bytes(12)), "another number of points"),
        (struct.pack("<I", 1) + zlib.compress(bytes(10**6)), "another number of points"),
        (struct.pack("<I", MOST + 1), "at most"),
    ],
)
def test_damaged_cloud_is_refused(data: bytes, reason: str) -> None:
    with pytest.raises(InvalidRequest, match=reason):
        unpack_points(data)
