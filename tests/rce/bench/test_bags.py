"""Benchmark of recordings, for a moment, and its comparison."""

from __future__ import annotations

import json
from pathlib import Path

from rce.bag.writer import BagWriter, Topic
from rce.bench import bags

STRING = Topic("/say", "std_msgs/msg/String", "string data\n")


def recorded(path: Path, *messages: tuple[int, bytes]) -> Path:
    writer = BagWriter(path)
    for time, cdr in messages:
        writer.put(STRING, cdr, time)
    writer.close({})
    return path


async def test_recording_is_measured_and_removed(tmp_path: Path) -> None:
    result = await bags.record(tmp_path / "a.mcap", 50e6, 0.2)
    assert result.dropped == 0
    assert result.rate > 0
    assert result.size > 5_000_000
    assert not (tmp_path / "a.mcap").exists()


def test_comparison_has_errors_of_intervals_and_bytes(tmp_path: Path) -> None:
    source = recorded(tmp_path / "a.mcap", (0, b"1"), (1_000_000_000, b"2"), (3_000_000_000, b"3"))
    copy = recorded(tmp_path / "b.mcap", (70, b"1"), (1_002_000_070, b"2"), (3_002_000_070, b"3"))
    found = bags.compare(source, copy)
    assert (found.messages, found.same) == (3, True)
    assert [round(each, 6) for each in found.errors] == [0.002, 0.0]
    assert not bags.compare(source, recorded(tmp_path / "c.mcap", (0, b"1"))).same
    result = bags.Recording(2e8, 0, 0.5, 10, [1e6, 1e6], 0.0)
    assert "same bytes" in bags.as_text(result, found)
    assert json.loads(json.dumps(bags.as_data(result, found)))["replay"]["messages"] == 3
