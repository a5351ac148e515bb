"""Numbered messages of robots, of which each is taken once."""

from __future__ import annotations

import pytest

from endpoints.robot import streams as module
from endpoints.robot.streams import Streams
from rce.errors import ConversionError, NotConnected
from rce.protocol.messages import DataMessage


def message(number: int, stream: str = "s") -> DataMessage:
    return DataMessage("out", "std_msgs/String", "nil", stream=stream, number=number)


def take(streams: Streams, number: int, error: Exception | None = None, stream: str = "s") -> bool:
    """Take a message as a receiver does; return whether it was new."""
    each = message(number, stream)
    if streams.taken(each) or not streams.begin(each):
        return False
    streams.end(each, error)  # type: ignore[arg-type]
    return True


def test_each_number_is_taken_once() -> None:
    streams = Streams("i")
    assert [take(streams, number) for number in (1, 2, 2, 1, 5, 3, 6)] == [True, True, False, False, True, False, True]


def test_streams_are_told_apart() -> None:
    streams = Streams("i")
    assert take(streams, 1)
    assert take(streams, 1, stream="other")


def test_message_that_is_being_taken_is_not_taken_again_and_not_acknowledged() -> None:
    streams = Streams("i")
    assert streams.begin(message(1))
    assert not streams.begin(message(1))
    assert not streams.taken(message(1))
    streams.end(message(1), None)
    assert streams.taken(message(1))


def test_message_without_a_peer_may_come_again_also_behind_later_ones() -> None:
    streams = Streams("i")
    assert take(streams, 1, NotConnected("no peer"))
    assert take(streams, 2)
    assert take(streams, 1)
    assert not take(streams, 1)


def test_message_that_was_refused_may_not_come_again() -> None:
    streams = Streams("i")
    assert take(streams, 1, ConversionError("wrong"))
    assert not take(streams, 1)


def test_stream_that_was_silent_longest_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_STREAMS", 2)
    streams = Streams("i")
    for number, stream in enumerate(("a", "b", "a", "c"), 1):
        take(streams, number, stream=stream)
    assert not take(streams, 3, stream="a")
    assert take(streams, 1, stream="b"), "forgotten"
    streams.end(message(7, "gone"), None)
