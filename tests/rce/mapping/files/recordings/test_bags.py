"""Reader of ROS bags."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.files.recordings import open_recording
from rce.mapping.files.recordings.bags import Bag
from tests.support.recordings import RANGES, WRITERS


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


def test_topic_with_most_scans_is_the_default(bag: Path) -> None:
    """`/rear` comes first by name, but has one scan only."""
    assert Bag(bag).scans == 3
    assert [scan.stamp for scan in Bag(bag)] == [1.0, 1.5, 2.0]


def test_bag_without_the_topic_of_odometry_is_rejected(bag: Path) -> None:
    with pytest.raises(InvalidRequest, match=r"no topic /wheels of type nav_msgs/msg/Odometry; .*: /odom"):
        Bag(bag, odometry_topic="/wheels")


def test_bag_can_be_read_twice(bag: Path) -> None:
    recording = Bag(bag)
    assert [scan.stamp for scan in recording] == [scan.stamp for scan in recording]


def test_scans_do_not_wait_for_odometry_that_ended(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rce.mapping.files.recordings.bags.MAX_WAITING", 0)
    scans = list(Bag(bag))
    assert [scan.stamp for scan in scans] == [1.0, 1.5, 2.0]
    assert scans[1].odometry == pytest.approx((1.0, 2.0, 0.5)), "the nearest, as the next has not come"


def test_bag_with_a_damaged_first_line_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    path.write_bytes(b"#ROSBAG V2.0\r\nabc")
    with pytest.raises(InvalidRequest, match="first line is damaged"):
        Bag(path)
