"""Recordings of topics."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from rosbags.rosbag2 import Reader

from endpoints.bridge import recorder
from endpoints.bridge.recorder import Recording
from rce.bench.chaos.disks import MEGABYTE, Disk, mounted
from rce.errors import InvalidRequest, Unavailable, UnknownType
from tests.support.endpoints.fake_local_ros import FakeLocalRos
from tests.support.privileges import skip_without_mounts

MESSAGE = b"\0\1\0\0\2\0\0\0a\0"


async def test_messages_are_in_bag(local: FakeLocalRos, tmp_path: Path) -> None:
    local.texts["mine/Thing"] = {"mine/msg/Thing": "std_msgs/Header header\nint32 size"}
    recording = await Recording.begin(local, {"/said": "std_msgs/String", "/things": "mine/Thing"}, tmp_path)
    for _ in range(2):
        local.interfaces["/said"].send(MESSAGE)
    local.interfaces["/things"].send(b"thing")
    recording.end()
    assert (recording.messages, local.interfaces) == (3, {})
    with Reader(recording.path) as bag:
        found = [(connection.topic, connection.msgtype, data) for connection, _, data in bag.messages()]
    said = ("/said", "std_msgs/msg/String", MESSAGE)
    assert found == [said, said, ("/things", "mine/msg/Thing", b"thing")]


async def test_recording_with_unknown_type_leaves_nothing_behind(local: FakeLocalRos, tmp_path: Path) -> None:
    with pytest.raises(UnknownType):
        await Recording.begin(local, {"/said": "std_msgs/String", "/things": "mine/Thing"}, tmp_path)
    assert local.interfaces == {}, "the first topic is not recorded on"


async def test_second_recording_within_same_second_is_rejected(
    local: FakeLocalRos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time, "strftime", lambda format: "20260101-000000")
    recording = await Recording.begin(local, {}, tmp_path)
    with pytest.raises(InvalidRequest, match="20260101-000000"):
        await Recording.begin(local, {}, tmp_path)
    recording.end()


async def test_directory_that_cannot_be_written_is_rejected(local: FakeLocalRos, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InvalidRequest, match="file"):
        await Recording.begin(local, {}, tmp_path / "file")


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[tuple[Path, Disk]]:
    skip_without_mounts()
    directory = tmp_path / "disk"
    with mounted({directory: 8 * MEGABYTE}) as disks:
        yield directory, disks[directory]


def text(number: int) -> bytes:
    """Return a serialized std_msgs/String of 100 kB that begins with a number."""
    body = f"{number:06}".encode() + bytes(100_000)
    return b"\0\1\0\0" + len(body).to_bytes(4, "little") + body


async def test_recording_goes_on_when_a_full_disk_has_room_again(
    local: FakeLocalRos, small_disk: tuple[Path, Disk], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder, "RETRY_INTERVAL", 0)
    directory, disk = small_disk
    recording = await Recording.begin(local, {"/said": "std_msgs/String"}, directory)
    for number in range(20):
        local.interfaces["/said"].send(text(number))
    disk.fill()
    for number in range(20, 40):
        local.interfaces["/said"].send(text(number))
    await disk.free()
    for number in range(40, 60):
        local.interfaces["/said"].send(text(number))
    recording.end()
    with Reader(recording.path) as bag:
        found = [int(data[8:14]) for _, _, data in bag.messages()]
    assert found == list(range(60))
    assert (recording.messages, recording.lost) == (60, 0)


async def test_messages_that_a_full_disk_does_not_take_are_told(
    local: FakeLocalRos, small_disk: tuple[Path, Disk]
) -> None:
    """They do not grow in memory meanwhile, and the reason is known at the end."""
    directory, disk = small_disk
    recording = await Recording.begin(local, {"/said": "std_msgs/String"}, directory)
    disk.fill()
    for number in range(200):
        local.interfaces["/said"].send(text(number))
    assert recording.lost > 150
    assert "disk full" in recording.summary()
    with pytest.raises(Unavailable, match="disk full"):
        recording.end()
    assert local.interfaces == {}
    await disk.free()
