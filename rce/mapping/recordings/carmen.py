"""CARMEN logs: text, one message a line (http://carmen.sourceforge.net/doc/logfile_format.html)."""

from __future__ import annotations

import gzip
import math
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from rce.errors import InvalidRequest
from rce.mapping.geometry import Pose
from rce.mapping.scans import Scan

# FLASER does not tell how far the laser sees. SICK lasers give one of these where they see nothing: 8.183 m and more in
# millimetre mode, 32.76 and 51.1 m on older models, 81.83 m and more in centimetre mode.
NO_RETURN = ((8.18, 8.2), (32.75, 32.78), (51.1, 51.3))
RANGE_MAX = 80.0
LONGEST_LINE = 4 * 1024 * 1024  # bytes
SNIFFED = 200  # scans that are read to find out which of these it is
COUNTED_BYTES = 256_000_000  # a larger file is not read twice to know its length
SCAN_LINES = (b"FLASER ", b"ROBOTLASER1 ")


class CarmenLog:
    """The scans of a CARMEN log: FLASER with raw ranges and odometry, or ROBOTLASER1. Stamps are `ipc_timestamp`.

    `scans` and `duration` (seconds) are None for very large files.
    """

    def __init__(self, path: Path) -> None:
        self.name = path.name
        self._path = path
        self.scans: int | None = None
        self.duration: float | None = None
        self._range_max = RANGE_MAX
        self._sniff()

    def __iter__(self) -> Iterator[Scan]:
        for number, line in self._lines():
            yield self._parse(number, line)

    def _sniff(self) -> None:
        """Read the first scans for the range of the laser, and all the others, unless there are too many, to count."""
        cheap = self._path.stat().st_size <= COUNTED_BYTES
        peak, count, begin, last = 0.0, 0, 0.0, (0, b"")
        for last in self._lines():
            count += 1
            if count <= SNIFFED:
                scan = self._parse(*last)
                begin = begin if count > 1 else scan.stamp
                peak = max(peak, float(scan.ranges.max(initial=0.0)))
            elif not cheap:
                break
        if not count:
            raise InvalidRequest(
                f"{self.name} has no laser scans: a CARMEN log with FLASER or ROBOTLASER1 lines is wanted", field="path"
            )
        self._range_max = next((low for low, high in NO_RETURN if low <= peak <= high), RANGE_MAX)
        if cheap:
            self.scans, self.duration = count, max(self._parse(*last).stamp - begin, 0.0)

    def _lines(self) -> Iterator[tuple[int, bytes]]:
        """The lines that are scans, with their numbers."""
        try:
            with gzip.open(self._path) if self._path.suffix == ".gz" else self._path.open("rb") as file:
                for number, line in enumerate(iter(lambda: file.readline(LONGEST_LINE), b""), 1):
                    if len(line) == LONGEST_LINE:  # what gzip makes small may have no end
                        raise InvalidRequest(f"{self.name}, line {number} is longer than any scan", field="path")
                    if line.startswith(SCAN_LINES):
                        yield number, line
        except (gzip.BadGzipFile, zlib.error, EOFError) as error:
            raise InvalidRequest(f"{self.name} is truncated or damaged: {error}", field="path") from error

    def _parse(self, number: int, line: bytes) -> Scan:
        words = line.split()
        try:
            scan = self._flaser(words) if words[0] == b"FLASER" else self._robotlaser(words)
        except (ValueError, IndexError) as error:
            raise InvalidRequest(
                f"{self.name}, line {number}: {words[0].decode()} is truncated or not as the format wants it ({error})",
                field="path",
            ) from error
        if not math.isfinite(scan.stamp):
            raise InvalidRequest(f"{self.name}, line {number}: the time stamp is not a number", field="path")
        return scan

    def _flaser(self, words: list[bytes]) -> Scan:
        """`FLASER n r1..rn x y theta odom_x odom_y odom_theta ipc_timestamp host logger_timestamp`."""
        count = _count(words[1])
        ranges, rest = _floats(words, 2, count), 2 + count
        odometry = Pose(*_floats(words, rest + 3, 3).tolist())
        increment = math.pi / (count - count % 2)  # half a circle; an even count lacks the last beam
        return Scan(
            float(words[rest + 6]), ranges.astype(np.float32), -math.pi / 2, increment, self._range_max, odometry
        )

    @staticmethod
    def _robotlaser(words: list[bytes]) -> Scan:
        """`ROBOTLASER1 type start fov increment range_max accuracy remission_mode n r1..rn m e1..em laser_pose(3)
        robot_pose(3) tv rv forward side turn_axis ipc_timestamp host logger_timestamp`."""
        start, _fov, increment, range_max = _floats(words, 2, 4).tolist()
        count = _count(words[8])
        remissions = int(words[9 + count])
        rest = 10 + count + remissions
        odometry = Pose(*_floats(words, rest + 3, 3).tolist())
        ranges = _floats(words, 9, count).astype(np.float32)
        return Scan(float(words[rest + 11]), ranges, start, increment, range_max, odometry)


def _floats(words: list[bytes], start: int, count: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    values = np.array(words[start : start + count], dtype=np.float64)
    if len(values) != count:
        raise IndexError(f"{count} numbers expected, {len(values)} found")
    return values


def _count(word: bytes) -> int:
    count = int(word)
    if count < 2:
        raise ValueError(f"{count} beams")
    return count
