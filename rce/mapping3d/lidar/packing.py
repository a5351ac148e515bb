"""Clouds as they are sent and kept: coordinates in steps of 5 mm, sorted, as differences, compressed by zlib."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from rce.errors import InvalidRequest

STEP = 0.005  # metres
MOST = 500_000  # points
COUNT = struct.Struct("<I")
WIDEST = 1 << 20  # steps from the lidar: 5 km

Points = NDArray[np.float32]  # (n, 3), metres


def pack_points(points: Points) -> bytes:
    """Return points (n, 3), compressed. Their order is lost, and each coordinate is rounded to `STEP`."""
    steps = np.clip(np.rint(points.astype(np.float64) / STEP), -WIDEST, WIDEST).astype(np.int32)
    ordered = steps[np.lexsort((steps[:, 2], steps[:, 1], steps[:, 0]))]
    differences = np.diff(ordered, axis=0, prepend=np.zeros((1, 3), np.int32))
    # All first bytes, then all second ones: the high bytes, which are alike, are neighbours.
    planes = np.ascontiguousarray(differences.T).astype("<i4").view(np.uint8).reshape(-1, 4).T
    return COUNT.pack(len(points)) + zlib.compress(np.ascontiguousarray(planes).tobytes(), 1)


def unpack_points(data: bytes) -> Points:
    """Return points (n, 3) that `pack_points` has packed.

    Raises:
        InvalidRequest: The data are damaged.
    """
    try:
        (count,) = COUNT.unpack_from(data)
        if count > MOST:
            raise InvalidRequest(f"a cloud has {count} points; at most {MOST} are allowed")
        inflate = zlib.decompressobj()
        content = inflate.decompress(data[COUNT.size :], 12 * count + 1)
        if len(content) != 12 * count:
            raise InvalidRequest("a cloud is damaged: it has another number of points than it says")
    except (struct.error, zlib.error) as error:
        raise InvalidRequest(f"a cloud is damaged: {error}") from None
    planes = np.frombuffer(content, np.uint8).reshape(4, -1)
    differences = np.ascontiguousarray(planes.T).view("<i4").reshape(3, count)
    steps = np.cumsum(differences, axis=1, dtype=np.int64).T
    points: Points = (steps * STEP).astype(np.float32)
    return points
