"""Scans as arrays, to send many of them in one message."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from msgspec import Struct

from rce.errors import InvalidRequest
from rce.mapping.geometry import Pose
from rce.mapping.scans import Scan


class ScanArrays(Struct, frozen=True):
    """Scans as buffers in little-endian order.

    Attributes:
        stamps: float64, seconds.
        lengths: int64, number of beams of each scan.
        ranges: float32, the ranges of all scans, metres.
        beams: float64, (n, 3) angle_min, angle_increment, range_max; radians and metres.
        odometry: float64, (n, 3) x, y, theta of the scans that have odometry.
        measured: bool, whether a scan has odometry.
    """

    stamps: bytes
    lengths: bytes
    ranges: bytes
    beams: bytes
    odometry: bytes
    measured: bytes


def pack_scans(scans: Sequence[Scan]) -> ScanArrays:
    """Return scans as arrays."""
    ranges = [np.asarray(scan.ranges, "<f4") for scan in scans]
    return ScanArrays(
        np.array([scan.stamp for scan in scans], "<f8").tobytes(),
        np.array([len(each) for each in ranges], "<i8").tobytes(),
        b"".join(each.tobytes() for each in ranges),
        np.array([(scan.angle_min, scan.angle_increment, scan.range_max) for scan in scans], "<f8").tobytes(),
        np.array([scan.odometry for scan in scans if scan.odometry is not None], "<f8").tobytes(),
        np.array([scan.odometry is not None for scan in scans], "?").tobytes(),
    )


def unpack_scans(packed: ScanArrays) -> Iterator[Scan]:
    """Yield the scans of arrays.

    Raises:
        InvalidRequest: The arrays do not fit together.
    """
    try:
        stamps = np.frombuffer(packed.stamps, "<f8")
        count = len(stamps)
        lengths = np.frombuffer(packed.lengths, "<i8")
        ranges = np.frombuffer(packed.ranges, "<f4")
        beams = np.frombuffer(packed.beams, "<f8").reshape(count, 3).tolist()
        measured = np.frombuffer(packed.measured, "?")
        odometry = iter(np.frombuffer(packed.odometry, "<f8").reshape(int(measured.sum()), 3).tolist())
    except ValueError as error:
        raise InvalidRequest(f"scans are damaged: {error}", field="scans") from None
    if len(lengths) != count or len(measured) != count or lengths.min(initial=0) < 0 or lengths.sum() != len(ranges):
        raise InvalidRequest("scans are damaged: their arrays have different lengths", field="scans")
    ends = np.cumsum(lengths).tolist()
    for stamp, length, end, has_odometry, (angle, step, limit) in zip(
        stamps.tolist(), lengths.tolist(), ends, measured.tolist(), beams, strict=True
    ):
        pose = Pose(*next(odometry)) if has_odometry else None
        yield Scan(stamp, ranges[end - length : end], angle, step, limit, pose)


def count_scans(packed: ScanArrays) -> int:
    """Return the number of scans."""
    return len(packed.measured)
