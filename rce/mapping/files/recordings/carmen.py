"""Reader of CARMEN logs: text, one message a line (http://carmen.sourceforge.net/doc/logfile_format.html)."""

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

# FLASER does not contain the range of the laser. SICK lasers report one of these if there is no echo: 8.183 m and more
# in millimetre mode, 32.76 and 51.1 m on older models, 81.83 m and more in centimetre mode.
NO_RETURN = ((8.18, 8.2), (32.75, 32.78), (51.1, 51.3))
RANGE_MAX = 80.0
MAX_LINE = 4 * 1024 * 1024  # bytes
SAMPLED_SCANS = 200  # scans that are read to find out the range of the laser
MAX_GAP = 1_000_000  # lines without a scan; a small gzip file may expand to billions
MAX_COUNTED = 256_000_000  # bytes; the scans of a larger file are not counted beforehand
SCAN_LINES = (b"FLASER ", b"ROBOTLASER1 ")


class CarmenLog:
    """Scans of a CARMEN log: FLASER with raw ranges and odometry, or ROBOTLASER1. Stamps are `ipc_timestamp`.

    Attributes:
        name: Name of the file.
        scans: Number of scans; None for very large files.
        duration: Seconds from the first scan to the last; None for very large files.
    """

    def __init__(self, path: Path) -> None:
        """Open a log.

        Raises:
            InvalidRequest: The file has no scans or is damaged.
        """
        self.name = path.name
        self._path = path
        self.scans: int | None = None
        self.duration: float | None = None
        self._range_max = RANGE_MAX
        self._inspect()

    def __iter__(self) -> Iterator[Scan]:
        """Yield the scans in the order of the file."""
        for number, line in self._lines():
            yield self._parse(number, line)

    def _inspect(self) -> None:
        """Read the first scans to find the range of the laser; count the others unless the file is large."""
        cheap = self._path.stat().st_size <= MAX_COUNTED
        peak, count, begin, last = 0.0, 0, 0.0, (0, b"")
        for last in self._lines():
            count += 1
            if count <= SAMPLED_SCANS:
                scan = self._parse(*last)
                begin = begin if count > 1 else scan.stamp
                peak = max(peak, float(scan.ranges.max(initial=0.0)))
            elif not cheap:
                break
        if not count:
            raise InvalidRequest(
                f"{self.name} has no laser scans: a CARMEN log must have FLASER or ROBOTLASER1 lines", field="path"
            )
        self._range_max = next((low for low, high in NO_RETURN if low <= peak <= high), RANGE_MAX)
        if cheap:
            self.scans, self.duration = count, max(self._parse(*last).stamp - begin, 0.0)

    def _lines(self) -> Iterator[tuple[int, bytes]]:
        """Yield the lines that are scans, with their numbers."""
        try:
            with gzip.open(self._path) if self._path.suffix == ".gz" else self._path.open("rb") as file:
                last = 0
                for number, line in enumerate(iter(lambda: file.readline(MAX_LINE), b""), 1):
                    if len(line) == MAX_LINE:  # a small gzip file may expand to a line without end
                        raise InvalidRequest(f"{self.name}, line {number} is longer than any scan", field="path")
                    if line.startswith(SCAN_LINES):
                        last = number
                        yield number, line
                    elif number - last > MAX_GAP:
                        text = f"{self.name} has no laser scans in {MAX_GAP} lines after line {last}"
                        raise InvalidRequest(text, field="path")
        except (gzip.BadGzipFile, zlib.error, EOFError) as error:
            raise InvalidRequest(f"{self.name} is truncated or damaged: {error}", field="path") from error

    def _parse(self, number: int, line: bytes) -> Scan:
        words = line.split()
        try:
            scan = self._flaser(words) if words[0] == b"FLASER" else self._robotlaser(words)
        except (ValueError, IndexError) as error:
            raise InvalidRequest(
                f"{self.name}, line {number}: {words[0].decode()} is truncated or not in the CARMEN format ({error})",
                field="path",
            ) from error
        if not math.isfinite(scan.stamp):
            raise InvalidRequest(f"{self.name}, line {number}: the time stamp is not a number", field="path")
        return scan

    def _flaser(self, words: list[bytes]) -> Scan:
        """Parse `FLASER n r1..rn x y theta odom_x odom_y odom_theta ipc_timestamp host logger_timestamp`."""
        count = _count(words[1])
        ranges, rest = _floats(words, 2, count), 2 + count
        odometry = Pose(*_floats(words, rest + 3, 3).tolist())
        increment = math.pi / (count - count % 2)  # half a circle; an even count lacks the last beam
        return Scan(
            float(words[rest + 6]), ranges.astype(np.float32), -math.pi / 2, increment, self._range_max, odometry
        )

    @staticmethod
    def _robotlaser(words: list[bytes]) -> Scan:
        """Parse a ROBOTLASER1 line.

        `ROBOTLASER1 type start fov increment range_max accuracy remission_mode n r1..rn m e1..em laser_pose(3)
        robot_pose(3) tv rv forward side turn_axis ipc_timestamp host logger_timestamp`.
        """
        start, _fov, increment, range_max = _floats(words, 2, 4).tolist()
        count = _count(words[8])
        remissions = int(words[9 + count])
        rest = 10 + count + remissions
        odometry = Pose(*_floats(words, rest + 3, 3).tolist())
        ranges = _floats(words, 9, count).astype(np.float32)
        return Scan(float(words[rest + 11]), ranges, start, increment, range_max, odometry)


def _floats(words: list[bytes], start: int, count: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return `count` numbers from word `start` on."""
    values = np.array(words[start : start + count], dtype=np.float64)
    if len(values) != count:
        raise IndexError(f"{count} numbers expected, {len(values)} found")
    return values


def _count(word: bytes) -> int:
    """Return the number of beams.

    Raises:
        ValueError: There are fewer than 2, which have no increment.
    """
    count = int(word)
    if count < 2:
        raise ValueError(f"{count} beams; a scan has at least 2")
    return count
