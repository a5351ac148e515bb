"""Writer of recordings: what other readers find in them, rotation, drops, failures."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from rce.bag import writer
from rce.bag.reader import Summary, read, summarize
from rce.bag.writer import BagWriter, Limits, Topic, join_definitions
from rce.errors import InvalidRequest, Unavailable

POINT = "float64 x\nfloat64 y\nfloat64 z\n"
STAMPED = "std_msgs/Header header\nPoint point\n"
STRING = Topic("/say", "std_msgs/msg/String", "string data\n")


def text(number: int, size: int = 0) -> bytes:
    body = f"{number:06}".encode() + bytes(size)
    return b"\0\1\0\0" + (len(body) + 1).to_bytes(4, "little") + body + b"\0"


def test_other_readers_find_messages_types_and_times(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    recording = BagWriter(path)
    for number in range(100):
        recording.put(STRING, text(number), 1_000_000_000 + number)
    recording.close({})
    assert recording.paths == [path]
    with path.open("rb") as file:
        reader = make_reader(file)
        header = reader.get_header()
        found = [
            (schema and schema.data, channel.topic, message) for schema, channel, message in reader.iter_messages()
        ]
    assert header.profile == "ros2"
    assert {(schema, topic) for schema, topic, _ in found} == {(b"string data\n", "/say")}
    assert [(message.log_time, message.data) for *_, message in found] == [
        (1_000_000_000 + number, text(number)) for number in range(100)
    ]


def test_rosbags_reads_the_messages(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    recording = BagWriter(path)
    recording.put(STRING, text(7), 5)
    recording.close({})
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_KILTED)) as reader:
        ((connection, time, data),) = reader.messages()
        message = reader.deserialize(data, connection.msgtype)
    assert (connection.topic, time, message.data) == ("/say", 5, "000007")  # type: ignore[attr-defined]


def test_next_file_begins_at_the_limit_of_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "CHUNK", 1)
    recording = BagWriter(tmp_path / "a.mcap", Limits(size=1))
    for number in range(3):
        recording.put(STRING, text(number), number)
    recording.close({"/lost": 4})
    assert [path.name for path in recording.paths] == ["a.mcap", "a-1.mcap", "a-2.mcap"]
    assert [[each.cdr for each in read(path)] for path in recording.paths] == [[text(number)] for number in range(3)]
    assert [summarize(path).dropped for path in recording.paths] == [{}, {}, {"/lost": 4}]


def test_messages_that_the_disk_cannot_take_are_dropped_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "MAX_WAITING", 3000)
    go, add = threading.Event(), Writer.add_message

    def held(*arguments: object, **more: object) -> None:
        go.wait(30)
        add(*arguments, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(Writer, "add_message", held)
    recording = BagWriter(tmp_path / "a.mcap")
    for number in range(10):
        recording.put(STRING, text(number, 1000), number)
    go.set()
    recording.close({"/say": 5})
    summary = summarize(tmp_path / "a.mcap")
    assert summary.counts["/say"] + summary.dropped["/say"] == 15
    assert summary.dropped["/say"] >= 5 + 6


def test_full_disk_ends_the_recording_with_the_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device", "a.mcap")

    monkeypatch.setattr(Writer, "add_message", full)
    recording = BagWriter(tmp_path / "a.mcap")
    recording.put(STRING, text(1), 1)
    with pytest.raises(Unavailable, match="disk full"):
        recording.close({})
    recording.put(STRING, text(2), 2)
    assert recording.dropped["/say"] == 1


def test_existing_file_is_kept(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_text("mine")
    with pytest.raises(InvalidRequest, match="File exists"):
        BagWriter(tmp_path / "a.mcap")
    assert (tmp_path / "a.mcap").read_text() == "mine"


def test_definition_has_those_that_it_contains() -> None:
    texts = {"a/msg/Stamped": STAMPED, "a/msg/Point": POINT, "std_msgs/msg/Header": "string frame_id"}
    separator = "=" * 80
    assert join_definitions(texts, "a/msg/Stamped") == (
        f"{STAMPED}{separator}\nMSG: a/Point\n{POINT}{separator}\nMSG: std_msgs/Header\nstring frame_id\n"
    )


def test_summary_of_an_empty_recording(tmp_path: Path) -> None:
    BagWriter(tmp_path / "a.mcap").close({})
    summary = summarize(tmp_path / "a.mcap")
    assert summary == Summary((tmp_path / "a.mcap").stat().st_size)
