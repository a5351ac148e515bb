"""Recordings of topics."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from rosbags.rosbag2 import Reader

from endpoints.bridge.recorder import Recording
from rce.errors import InvalidRequest, UnknownType
from tests.support.endpoints.fake_local_ros import FakeLocalRos

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
