"""Flood of the benchmark: what it reads from the frames of its robot. tests/e2e/test_bench_traffic.py runs it."""

from __future__ import annotations

import msgspec

from rce.bench.traffic.crowd import BEGIN
from rce.bench.traffic.flood import NUMBER, Reading
from rce.protocol.messages import DataMessage, DropEvent, Status


def test_number_and_drops_are_found_in_frames_of_the_platform() -> None:
    content = msgspec.Raw(msgspec.json.encode({"data": "0000000042xxx"}))
    text = msgspec.json.encode({"type": "DM", "data": DataMessage("flood", "std_msgs/String", "nil", content)})
    begin = BEGIN.search(text)
    assert begin is not None
    assert text[begin.end() : begin.end() + NUMBER] == b"0000000042"
    read = Reading()
    read.received(text)
    for count, where in ((5, "in environment flooded"), (12, "on the way to the robot"), (7, "in environment flooded")):
        read.received(msgspec.json.encode(Status(DropEvent("flood", count, where))))
    assert (read.numbers, read.dropped()) == ([42], 19)
