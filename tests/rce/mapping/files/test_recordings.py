from __future__ import annotations

import gzip
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

from rce.errors import InvalidRequest, NotFound
from rce.mapping.files.recordings import open_recording
from rce.mapping.geometry import Pose

RANGES = (1.0, 2.5, 81.91, 3.0)


def flaser(stamp: float, x: float = 0.0, ranges: tuple[float, ...] = RANGES) -> str:
    values = " ".join(f"{value:.2f}" for value in ranges)
    return f"FLASER {len(ranges)} {values} 9 9 9 {x} 2.0 0.5 {stamp:.6f} host 0.1\n"


def carmen(path: Path, text: str) -> Path:
    if path.suffix == ".gz":
        path.write_bytes(gzip.compress(text.encode()))
    else:
        path.write_text(text)
    return path


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


def test_invalid_stamps_are_made_to_increase(tmp_path: Path) -> None:
    stamps = (-0.4, 4294970000.0, 5.0, 5.0, 4.0, 6.0)
    recording = open_recording(carmen(tmp_path / "a.log", "".join(flaser(stamp) for stamp in stamps)))
    repaired = [scan.stamp for scan in recording]
    assert len({f"{stamp:.6f}" for stamp in repaired}) == len(stamps)
    assert repaired == sorted(repaired)
    assert (repaired[2], repaired[5]) == (5.0, 6.0)
    assert 0 <= repaired[0] < repaired[1] < 1


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


def test_missing_recording_is_not_found(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="no such recording"):
        open_recording(tmp_path / "a.log")


Message = Any  # types made by rosbags at run time


class Sample:
    """Messages of one robot: scans at 1.0, 1.5 and 2.0 s, odometry at 1.0 and 2.0 s."""

    def __init__(self, store: Stores) -> None:
        self.store, self.ros1 = get_typestore(store), store is Stores.ROS1_NOETIC

    def make(self, name: str, *fields: Message) -> Message:
        return self.store.types[name](*fields)

    def header(self, stamp: float) -> Message:
        time = self.make("builtin_interfaces/msg/Time", int(stamp), round(stamp % 1 * 1e9))
        sequence = (0,) if self.ros1 else ()
        return self.make("std_msgs/msg/Header", *sequence, time, "laser")

    def scan(self, stamp: float) -> Message:
        ranges, none = np.array(RANGES, np.float32), np.array([], np.float32)
        values = (-1.0, 1.0, 0.5, 0.0, 0.0, 0.1, 80.0, ranges, none)
        return self.make("sensor_msgs/msg/LaserScan", self.header(stamp), *values)

    def odometry(self, stamp: float, x: float) -> Message:
        point = self.make("geometry_msgs/msg/Point", x, 2.0, 0.0)
        turn = self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(0.25), math.cos(0.25))
        pose = self.make("geometry_msgs/msg/Pose", point, turn)
        zero = self.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        twist, covariance = self.make("geometry_msgs/msg/Twist", zero, zero), np.zeros(36)
        return self.make(
            "nav_msgs/msg/Odometry",
            self.header(stamp),
            "base_link",
            self.make("geometry_msgs/msg/PoseWithCovariance", pose, covariance),
            self.make("geometry_msgs/msg/TwistWithCovariance", twist, covariance),
        )

    def messages(self) -> list[tuple[str, float, Message]]:
        scans = [("/scan", stamp, self.scan(stamp)) for stamp in (1.0, 1.5, 2.0)]
        moves = [("/odom", stamp, self.odometry(stamp, x)) for stamp, x in ((1.0, 1.0), (2.0, 3.0))]
        rear = [("/rear", 1.0, self.scan(1.0))]
        return sorted(scans + moves + rear, key=lambda item: item[1])


def bag1(directory: Path) -> Path:
    sample, path = Sample(Stores.ROS1_NOETIC), directory / "a.bag"
    with rosbag1.Writer(path) as writer:
        connections = {}
        for topic, stamp, message in sample.messages():
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=sample.store)
            data = sample.store.serialize_ros1(message, kind)
            writer.write(connections[topic], round(stamp * 1e9), data)
    return path


def bag2(directory: Path, storage: rosbag2.StoragePlugin) -> Path:
    sample, path = Sample(Stores.ROS2_HUMBLE), directory / "bag"
    with rosbag2.Writer(path, version=9, storage_plugin=storage) as writer:
        connections = {}
        for topic, stamp, message in sample.messages():
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=sample.store)
            writer.write(connections[topic], round(stamp * 1e9), sample.store.serialize_cdr(message, kind))
    return path


WRITERS: dict[str, Callable[[Path], Path]] = {
    "ros1": bag1,
    "db3": lambda directory: bag2(directory, rosbag2.StoragePlugin.SQLITE3),
    "mcap": lambda directory: bag2(directory, rosbag2.StoragePlugin.MCAP),
}


@pytest.fixture(params=WRITERS)
def bag(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return WRITERS[request.param](tmp_path)


def test_bags_are_read_with_the_odometry_of_each_stamp(bag: Path) -> None:
    recording = open_recording(bag)
    assert recording.scans == 3
    assert recording.duration == pytest.approx(1.0, abs=1e-6)
    scans = list(recording)
    assert [scan.stamp for scan in scans] == [1.0, 1.5, 2.0]
    assert [scan.odometry for scan in scans] == [pytest.approx((x, 2.0, 0.5)) for x in (1.0, 2.0, 3.0)]
    np.testing.assert_array_equal(scans[0].ranges, np.array(RANGES, np.float32))
    assert (scans[0].angle_min, scans[0].angle_increment, scans[0].range_max) == (-1.0, 0.5, 80.0)


def test_topic_can_be_chosen(bag: Path) -> None:
    assert open_recording(bag, scan_topic="/rear").scans == 1
    with pytest.raises(InvalidRequest, match="topics of this type: /rear, /scan"):
        open_recording(bag, scan_topic="/left")


def test_single_file_of_ros_2_bag_is_read(tmp_path: Path) -> None:
    directory = WRITERS["mcap"](tmp_path)
    (file,) = directory.glob("*.mcap")
    assert open_recording(file).scans == 3


def test_damaged_bags_are_rejected(bag: Path) -> None:
    file = bag if bag.is_file() else next(path for path in bag.iterdir() if path.suffix != ".yaml")
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 3])
    with pytest.raises(InvalidRequest, match="truncated, damaged or not indexed"):
        list(open_recording(bag))


def test_error_does_not_disclose_the_directory(tmp_path: Path) -> None:
    path = tmp_path / "scans.db3"
    path.write_bytes(b"SQLite format 3\0" + bytes(range(256)) * 16)
    with pytest.raises(InvalidRequest, match="not a database") as refused:
        open_recording(path)
    assert str(tmp_path) not in str(refused.value)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "is empty"),
        (b"#ROSRECORD V1.2\nabc", r"format 1\.2.*rosbag fix"),
        (b"#ROSBAG V1.1\nabc", r"format 1\.1"),
        (b"PK\x03\x04", "not a ROS bag"),
        (b"#ROSBAG V2.0\n", "truncated"),
    ],
)
def test_files_of_other_formats_are_rejected(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / "a.bag"
    path.write_bytes(content)
    with pytest.raises(InvalidRequest, match=reason):
        open_recording(path)


def test_directory_without_metadata_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match=r"no metadata\.yaml"):
        open_recording(tmp_path)


def test_reading_stops_at_an_endless_line(tmp_path: Path) -> None:
    """A megabyte of gzip may expand to a gigabyte without a line break."""
    path = tmp_path / "long.clf.gz"
    with gzip.open(path, "wb") as file:
        for _ in range(8):
            file.write(bytes(1024 * 1024))
    with pytest.raises(InvalidRequest, match="line 1 is longer"):
        open_recording(path)
