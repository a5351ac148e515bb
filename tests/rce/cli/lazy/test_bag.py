"""Texts and messages of `rce bag`."""

from __future__ import annotations

from rce.bag.reader import Summary
from rce.cli.lazy.bag import clock_message, info_text


def test_description_of_a_recording() -> None:
    summary = Summary(2048, complete=False, start=10**18, end=10**18 + 2 * 10**9)
    summary.types, summary.counts = {"/say": "std_msgs/msg/String"}, {"/say": 7}
    summary.dropped = {"/say": 2, "/scan": 3}
    lines = info_text("a.mcap", summary).splitlines()
    assert lines[:3] == ["file      a.mcap", "size      2 KiB, cut off: it has no end", "duration  2.000 s"]
    assert [line.split() for line in lines[5:]] == [
        ["/say", "7", "std_msgs/msg/String,", "2", "dropped"],
        ["/scan", "0", "3", "dropped"],
    ]


def test_clock_message_has_seconds_and_nanoseconds() -> None:
    assert clock_message(5_000_000_007) == b"\0\1\0\0" + (5).to_bytes(4, "little") + (7).to_bytes(4, "little")
