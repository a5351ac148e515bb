"""Recorded robot data as a stream of scans, whatever the format of the file."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from rce.errors import InvalidRequest, NotFound
from rce.mapping.recordings.bags import Bag
from rce.mapping.recordings.carmen import CarmenLog
from rce.mapping.scans import Scan

CARMEN_SUFFIXES = (".clf", ".log", ".clf.gz", ".log.gz")
BAG_SUFFIXES = (".bag", ".db3", ".mcap")
LAST_STAMP = 2.0**31  # seconds; ROS carries no later ones
TICK = 1e-5  # seconds; still tells two stamps apart when they are written with six decimals


class Recording(Protocol):
    """A recording: iterate over it, as often as needed, for its scans in order of time.

    `scans`: how many there are, `duration`: seconds from the first to the last; None where that takes long to find out.
    Iterating raises InvalidRequest where the file turns out to be damaged.
    """

    name: str
    scans: int | None
    duration: float | None

    def __iter__(self) -> Iterator[Scan]: ...


def open_recording(path: Path, scan_topic: str = "", odometry_topic: str = "") -> Recording:
    """Open a CARMEN log, a ROS 1 bag, or a ROS 2 bag (its directory, or a single .db3 or .mcap file).

    The topics are for bags with several of one type; without them the type alone decides.
    Raises NotFound if there is no such file, InvalidRequest if it is none of these, damaged, or has no scans.
    """
    if not path.exists():
        raise NotFound(f"no such recording: {path}", field="path")
    if path.is_dir() or path.suffix in BAG_SUFFIXES:
        return Steady(Bag(path, scan_topic, odometry_topic))
    if path.name.endswith(CARMEN_SUFFIXES):
        return Steady(CarmenLog(path))
    known = ", ".join((*CARMEN_SUFFIXES, *BAG_SUFFIXES))
    raise InvalidRequest(
        f"{path.name} is not a recording by its name: {known} or the directory of a ROS 2 bag", field="path"
    )


class Steady:
    """A recording whose stamps are those of another one, made to increase and to fit ROS.

    Old logs have stamps that stand still, wrapped or were never set. A stamp identifies a scan all the way through the
    platform, so one that does not increase becomes the one before plus 10 microseconds.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self.name, self.scans = recording.name, recording.scans
        usable = recording.duration is not None and 0.0 < recording.duration < LAST_STAMP
        self.duration = recording.duration if usable else None

    def __iter__(self) -> Iterator[Scan]:
        last = -math.inf
        for scan in self._recording:
            if not max(last, 0.0) <= scan.stamp < LAST_STAMP or scan.stamp == last:
                scan = dataclasses.replace(scan, stamp=max(last + TICK, 0.0))
            last = scan.stamp
            yield scan
