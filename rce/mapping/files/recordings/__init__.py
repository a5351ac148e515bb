"""Recordings of robots as streams of scans, independent of the file format."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from rce.errors import InvalidRequest, NotFound
from rce.mapping.files.recordings.bags import Bag
from rce.mapping.files.recordings.carmen import CarmenLog
from rce.mapping.scan_cutting import BAND, Band
from rce.mapping.scans import Scan

CARMEN_SUFFIXES = (".clf", ".log", ".clf.gz", ".log.gz")
BAG_SUFFIXES = (".bag", ".db3", ".mcap")
MAX_STAMP = 2.0**31  # seconds; the limit of ROS messages
TICK = 1e-5  # seconds; two stamps this far apart still differ when they are written with six decimals


class Recording(Protocol):
    """Recording that can be iterated repeatedly and yields its scans in order of time.

    The iteration raises InvalidRequest if the file turns out to be damaged.

    Attributes:
        name: Name of the file.
        scans: Number of scans; None if that takes long to find out.
        duration: Seconds from the first scan to the last; None if that takes long to find out.
    """

    name: str
    scans: int | None
    duration: float | None

    def __iter__(self) -> Iterator[Scan]:
        """Yield the scans in order of time."""


def open_recording(path: Path, scan_topic: str = "", odometry_topic: str = "", band: Band = BAND) -> Recording:
    """Open a CARMEN log, a ROS 1 bag, or a ROS 2 bag (its directory, or a single .db3 or .mcap file).

    Args:
        path: The file or directory.
        scan_topic: Topic of the scans in a bag, if it has several, or of clouds from which scans are cut.
        odometry_topic: Topic of the odometry in a bag, if it has several.
        band: What is cut from the clouds of a bag without scans.

    Raises:
        NotFound: The file does not exist.
        InvalidRequest: The file has another format, is damaged, or has no scans.
    """
    if not path.exists():
        raise NotFound(f"no such recording: {path}", field="path")
    if path.is_dir() or path.suffix in BAG_SUFFIXES:
        return MonotonicRecording(Bag(path, scan_topic, odometry_topic, band))
    if path.name.endswith(CARMEN_SUFFIXES):
        return MonotonicRecording(CarmenLog(path))
    known = ", ".join((*CARMEN_SUFFIXES, *BAG_SUFFIXES))
    raise InvalidRequest(
        f"{path.name} is not a recording: the name must end in {known}, or be the directory of a ROS 2 bag",
        field="path",
    )


class MonotonicRecording:
    """Recording with strictly increasing stamps that fit into ROS messages, and with at least one range.

    Old logs have stamps that stand still, have wrapped or were never set. Stamps identify scans throughout the
    platform: one that does not increase is replaced by the one before plus 10 microseconds.

    Attributes:
        name: Name of the file.
        scans: Number of scans, or None.
        duration: Seconds from the first scan to the last, or None.
    """

    def __init__(self, recording: Recording) -> None:
        """Wrap a recording."""
        self._recording = recording
        self.name, self.scans = recording.name, recording.scans
        usable = recording.duration is not None and 0.0 < recording.duration < MAX_STAMP
        self.duration = recording.duration if usable else None

    def __iter__(self) -> Iterator[Scan]:
        """Yield the scans with repaired stamps.

        Raises:
            InvalidRequest: A pose is not a number, or no beam of the whole recording measured anything.
        """
        last, void = -math.inf, True
        for number, scan in enumerate(self._recording, 1):
            if scan.odometry is not None and not all(map(math.isfinite, scan.odometry)):
                raise InvalidRequest(f"{self.name}, scan {number}: the odometry is not a number", field="path")
            if not max(last, 0.0) <= scan.stamp < MAX_STAMP or scan.stamp == last:
                scan = dataclasses.replace(scan, stamp=max(last + TICK, 0.0))
            last = scan.stamp
            void = void and not len(scan.points(math.inf))
            yield scan
        if void and last >= 0.0:
            raise InvalidRequest(
                f"{self.name} has no ranges: no beam of any scan measured a distance within the range of the laser",
                field="path",
            )
