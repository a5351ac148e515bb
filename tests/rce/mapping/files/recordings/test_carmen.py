"""Reader of CARMEN logs."""

from __future__ import annotations

import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.files.recordings import open_recording
from rce.mapping.files.recordings.carmen import CarmenLog
from rce.mapping.geometry import Pose
from tests.support.recordings import RANGES, carmen, flaser


@pytest.mark.parametrize("name", ["a.clf", "a.log", "a.clf.gz", "a.log.gz"])
def test_flaser_is_read_with_odometry_and_ipc_timestamp(tmp_path: Path, name: str) -> None:
    text = "# a comment\nPARAM robot x 1 h 1\nODOM 1 2 3 0 0 0 5.0 h 5.0\n" + flaser(10.25, 1.0) + flaser(10.5, 2.0)
    recording = open_recording(carmen(tmp_path / name, text))
    assert (recording.name, recording.scans, recording.duration) == (name, 2, 0.25)
    first, second = recording
    assert (first.stamp, second.stamp) == (10.25, 10.5)
    assert first.odometry == Pose(1.0, 2.0, 0.5)
    assert first.ranges.dtype == np.float32
    np.testing.assert_allclose(first.ranges, RANGES, rtol=1e-6)
    assert first.angle_min == -math.pi / 2
    assert first.range_max < 81.83
    assert len(list(recording)) == 2, "a recording can be read again"


@pytest.mark.parametrize(("beams", "degrees"), [(180, 1.0), (181, 1.0), (360, 0.5), (361, 0.5)])
def test_angles_of_flaser_follow_from_the_number_of_beams(tmp_path: Path, beams: int, degrees: float) -> None:
    (scan,) = open_recording(carmen(tmp_path / "a.log", flaser(1.0, ranges=(2.0,) * beams)))
    assert math.degrees(scan.angle_increment) == pytest.approx(degrees)


@pytest.mark.parametrize("no_return", [8.191, 32.767, 51.15, 81.83, 81.91])
def test_no_echo_values_of_sick_lasers_are_ignored(tmp_path: Path, no_return: float) -> None:
    (scan,) = open_recording(carmen(tmp_path / "a.log", flaser(1.0, ranges=(2.0, 4.0, no_return))))
    assert len(scan.points(1000.0)) == 2


def test_robotlaser_is_read(tmp_path: Path) -> None:
    line = "ROBOTLASER1 0 -1.2 2.4 0.8 30.0 0.01 0 4 1 2 3 4 2 7 7 9 9 9 1.5 2.5 0.25 0 0 0.3 0.3 1000 12.5 host 0.1\n"
    (scan,) = open_recording(carmen(tmp_path / "a.log", line))
    assert (scan.stamp, scan.angle_min, scan.angle_increment, scan.range_max) == (12.5, -1.2, 0.8, 30.0)
    assert scan.odometry == Pose(1.5, 2.5, 0.25)
    assert scan.ranges.tolist() == [1.0, 2.0, 3.0, 4.0]


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("a.log", "", "no laser scans"),
        ("a.log", "ODOM 1 2 3 0 0 0 5.0 h 5.0\n", "no laser scans"),
        ("a.log", flaser(1.0) + "FLASER 4 1.0 2.0", "line 2.*truncated"),
        ("a.log", "FLASER x 1.0 2.0\n", "line 1"),
        ("a.log", "FLASER 0 0 0 0 0 0 0 1.0 h 1\n", "line 1"),
        ("a.log", "FLASER -5 0 0 0 0 0 0 1.0 h 1\n", "line 1"),
        ("a.log", flaser(math.nan), "time stamp"),
        ("a.csv", flaser(1.0), "not a recording: the name must end in"),
    ],
)
def test_damaged_logs_are_rejected_with_the_reason(tmp_path: Path, name: str, text: str, reason: str) -> None:
    with pytest.raises(InvalidRequest, match=reason):
        open_recording(carmen(tmp_path / name, text))


def test_truncated_or_invalid_gzip_file_is_rejected(tmp_path: Path) -> None:
    path = carmen(tmp_path / "a.log.gz", "".join(flaser(i, ranges=(i / 7,) * 50) for i in range(100)))
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InvalidRequest, match="truncated or damaged"):
        open_recording(path)
    path.write_text(flaser(1.0))
    with pytest.raises(InvalidRequest, match="truncated or damaged"):
        open_recording(path)


def test_reading_stops_at_an_endless_line(tmp_path: Path) -> None:
    """A megabyte of gzip may expand to a gigabyte without a line break."""
    path = tmp_path / "long.clf.gz"
    with gzip.open(path, "wb") as file:
        for _ in range(8):
            file.write(bytes(1024 * 1024))
    with pytest.raises(InvalidRequest, match="line 1 is longer"):
        open_recording(path)


def test_reading_stops_after_many_lines_without_a_scan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A megabyte of gzip may expand to a billion empty lines."""
    monkeypatch.setattr("rce.mapping.files.recordings.carmen.MAX_GAP", 100)
    assert len(list(open_recording(carmen(tmp_path / "a.log", (flaser(1.0) + "\n" * 100) * 3)))) == 3
    with pytest.raises(InvalidRequest, match="no laser scans in 100 lines after line 0"):
        open_recording(carmen(tmp_path / "b.log.gz", "\n" * 101 + flaser(1.0)))
    with pytest.raises(InvalidRequest, match="no laser scans in 100 lines after line 1"):
        open_recording(carmen(tmp_path / "c.log.gz", flaser(1.0) + "\n" * 101))


@pytest.mark.parametrize("pose", [math.nan, math.inf, -math.inf])
def test_poses_that_are_not_numbers_are_refused(tmp_path: Path, pose: float) -> None:
    recording = open_recording(carmen(tmp_path / "a.log", flaser(1.0) + flaser(2.0, x=pose)))
    with pytest.raises(InvalidRequest, match=r"a\.log, scan 2: the odometry is not a number"):
        list(recording)


@pytest.mark.parametrize("ranges", [(81.91, 81.91), (0.0, 0.0), (math.nan, math.inf)])
def test_recording_without_any_range_is_refused_at_its_end(tmp_path: Path, ranges: tuple[float, ...]) -> None:
    recording = open_recording(carmen(tmp_path / "a.log", flaser(1.0, ranges=ranges) + flaser(2.0, ranges=ranges)))
    with pytest.raises(InvalidRequest, match=r"a\.log has no ranges"):
        list(recording)


def test_scans_of_a_large_log_are_not_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = carmen(tmp_path / "a.log", "".join(flaser(float(i)) for i in range(1, 9)))
    monkeypatch.setattr("rce.mapping.files.recordings.carmen.MAX_COUNTED", 10)
    monkeypatch.setattr("rce.mapping.files.recordings.carmen.SAMPLED_SCANS", 2)
    log = CarmenLog(path)
    assert (log.scans, log.duration) == (None, None)
    assert len(list(log)) == 8


def test_range_of_the_laser_is_found_in_the_first_scans(tmp_path: Path) -> None:
    text = flaser(1.0, ranges=(2.0, 3.0, 4.0)) + flaser(2.0, ranges=(2.0, 8.19, 4.0))
    first, second = CarmenLog(carmen(tmp_path / "a.log", text))
    assert first.range_max == second.range_max == 8.18
    assert len(second.points(1000.0)) == 2


def test_damage_far_behind_is_found_while_reading(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rce.mapping.files.recordings.carmen.SAMPLED_SCANS", 1)
    log = CarmenLog(carmen(tmp_path / "a.log", flaser(1.0) + "FLASER 4 1.0\n" + flaser(2.0)))
    assert log.scans == 3
    with pytest.raises(InvalidRequest, match="line 2"):
        list(log)
