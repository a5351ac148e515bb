"""Giving each scan the odometry of its stamp, where the two come as separate streams."""

from __future__ import annotations

import bisect
import dataclasses
from collections import deque

from rce.mapping.geometry import Pose, interpolate
from rce.mapping.scans import Scan

SAME = 1e-6  # seconds between stamps that mean the same instant
NEAR = 0.5  # seconds by which odometry may be too old or new, where there is none on the other side
KEPT = 10_000  # odometry messages that wait for a scan; 100 s at 100 Hz


class OdometryPairing:
    """Scans and odometry in, each in order of its stamps; scans with odometry out, in order.

    Odometry of the very stamp is taken as it is; otherwise it is interpolated, for which a scan waits until odometry
    after it has come. `flush` ends the wait.
    """

    def __init__(self) -> None:
        self._waiting: deque[Scan] = deque()
        self._stamps: list[float] = []
        self._poses: list[Pose] = []

    def __len__(self) -> int:
        """How many scans wait."""
        return len(self._waiting)

    def add_odometry(self, stamp: float, pose: Pose) -> None:
        if self._stamps and stamp <= self._stamps[-1]:
            return  # sent twice
        self._stamps.append(stamp)
        self._poses.append(pose)
        if len(self._stamps) > 2 * KEPT:
            del self._stamps[:-KEPT], self._poses[:-KEPT]

    def add_scan(self, scan: Scan) -> None:
        self._waiting.append(scan)

    def ready(self) -> list[Scan]:
        """The scans, oldest first, for which no later odometry can change anything."""
        done: list[Scan] = []
        while self._waiting and self._stamps and self._waiting[0].stamp <= self._stamps[-1] + SAME:
            done.append(self._paired(self._waiting.popleft()))
        return done

    def flush(self) -> list[Scan]:
        """All scans that wait, with the odometry nearest to them, or with none."""
        done = [self._paired(scan) for scan in self._waiting]
        self._waiting.clear()
        return done

    def _paired(self, scan: Scan) -> Scan:
        return dataclasses.replace(scan, odometry=self._at(scan.stamp))

    def _at(self, stamp: float) -> Pose | None:
        after = bisect.bisect_left(self._stamps, stamp - SAME)
        inside = after < len(self._stamps)
        if inside and self._stamps[after] <= stamp + SAME:
            return self._poses[after]
        if inside and after > 0:
            begin, end = self._stamps[after - 1 : after + 1]
            return interpolate(self._poses[after - 1], self._poses[after], (stamp - begin) / (end - begin))
        nearest = after if inside else after - 1
        near = self._stamps and abs(self._stamps[nearest] - stamp) <= NEAR
        return self._poses[nearest] if near else None
