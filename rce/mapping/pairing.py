"""Pairing of scans with the odometry of their stamp, where the two come as separate streams."""

from __future__ import annotations

import bisect
import dataclasses
from collections import deque

from rce.mapping.geometry import Pose, interpolate
from rce.mapping.scans import Scan

SAME_STAMP = 1e-6  # seconds between stamps that mean the same instant
MAX_AGE = 0.5  # seconds between a scan and the only odometry on one side of it; older odometry is not used
MAX_ODOMETRY = 10_000  # odometry messages that are kept for scans to come; 100 s at 100 Hz


class OdometryPairing:
    """Scans and odometry in, each in order of their stamps; scans with odometry out, in order.

    Odometry of exactly the stamp of a scan is used as it is. Otherwise it is interpolated, for which the scan waits
    until odometry after it has come. `flush` ends the wait.
    """

    def __init__(self) -> None:
        """Start without scans and odometry."""
        self._waiting: deque[Scan] = deque()
        self._stamps: list[float] = []
        self._poses: list[Pose] = []

    def __len__(self) -> int:
        """Return the number of scans that wait."""
        return len(self._waiting)

    def add_odometry(self, stamp: float, pose: Pose) -> None:
        """Add odometry; that of a stamp not after the last one is a duplicate and ignored."""
        if self._stamps and stamp <= self._stamps[-1]:
            return
        self._stamps.append(stamp)
        self._poses.append(pose)
        if len(self._stamps) > 2 * MAX_ODOMETRY:
            del self._stamps[:-MAX_ODOMETRY], self._poses[:-MAX_ODOMETRY]

    def add_scan(self, scan: Scan) -> None:
        """Add a scan that waits for its odometry."""
        self._waiting.append(scan)

    def ready(self) -> list[Scan]:
        """Return and remove the scans, oldest first, whose odometry no later message can change."""
        done: list[Scan] = []
        while self._waiting and self._stamps and self._waiting[0].stamp <= self._stamps[-1] + SAME_STAMP:
            done.append(self._paired(self._waiting.popleft()))
        return done

    def flush(self) -> list[Scan]:
        """Return and remove all waiting scans, each with the odometry nearest to it, or with none."""
        done = [self._paired(scan) for scan in self._waiting]
        self._waiting.clear()
        return done

    def _paired(self, scan: Scan) -> Scan:
        return dataclasses.replace(scan, odometry=self._at(scan.stamp))

    def _at(self, stamp: float) -> Pose | None:
        """Return the odometry at a stamp: exact, interpolated, or the nearest within MAX_AGE."""
        after = bisect.bisect_left(self._stamps, stamp - SAME_STAMP)
        inside = after < len(self._stamps)
        if inside and self._stamps[after] <= stamp + SAME_STAMP:
            return self._poses[after]
        if inside and after > 0:
            begin, end = self._stamps[after - 1 : after + 1]
            return interpolate(self._poses[after - 1], self._poses[after], (stamp - begin) / (end - begin))
        nearest = after if inside else after - 1
        near = self._stamps and abs(self._stamps[nearest] - stamp) <= MAX_AGE
        return self._poses[nearest] if near else None
