"""Queues in front of a stream: round robin, order, bounds, back-pressure, and a stream that breaks."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rce.net.outbox import HIGH_WATER, Outbox, Priority

A, B, C = b"a", b"b", b"c"


class Stream:
    """Stream that is full after `credit` pieces."""

    def __init__(self, credit: int = 10**9) -> None:
        self.credit = credit
        self.written: list[str] = []
        self.outbox: Outbox[str] = Outbox(self.write)

    def write(self, piece: str) -> bool:
        assert self.credit > 0, "written to while it was full"
        self.written.append(piece)
        self.credit -= 1
        return self.credit > 0

    def resume(self, credit: int = 10**9) -> list[str]:
        self.credit = credit
        self.written.clear()
        self.outbox.resume()
        return self.written


def message(name: str, count: int = 1) -> Iterator[str]:
    return (f"{name}{index}" for index in range(count))


def test_small_message_waits_for_one_piece_of_each_large_one() -> None:
    stream = Stream()
    stream.outbox.pause()
    stream.outbox.put(A, message("a", 100), None)
    stream.outbox.put(B, message("b", 100), None)
    stream.resume(10)
    stream.outbox.put(C, message("c"), None)
    assert "c0" in stream.resume(3)


@given(st.lists(st.tuples(st.sampled_from([A, B, C]), st.integers(0, 5)), max_size=30), st.data())
def test_order_within_a_source_is_kept_and_nothing_is_lost(puts: list[tuple[bytes, int]], data: st.DataObject) -> None:
    stream, got, sent = Stream(data.draw(st.integers(1, 5))), [], []
    for number, (source, count) in enumerate(puts):
        name = f"{source.decode()}:{number}:"
        sent += [f"{name}{index}" for index in range(count)]
        stream.outbox.put(source, message(name, count), None)
        if stream.credit == 0:
            got += stream.written
            stream.written.clear()
            stream.resume(data.draw(st.integers(1, 5)))
    got += stream.written
    got += stream.resume()
    for letter in "abc":
        assert [piece for piece in got if piece[0] == letter] == [piece for piece in sent if piece[0] == letter]
    assert stream.outbox.empty


def test_bounded_queue_keeps_the_newest_messages_and_counts_drops() -> None:
    stream = Stream()
    stream.outbox.pause()
    dropped = [stream.outbox.put(A, message(f"a{number}."), 3) for number in range(6)]
    assert dropped == [0, 0, 0, 1, 1, 1]
    assert stream.outbox.backlog(A) == 3
    assert stream.resume() == ["a3.0", "a4.0", "a5.0"]


def test_message_being_sent_is_not_dropped() -> None:
    stream = Stream(1)
    stream.outbox.put(A, message("big", 3), 1)
    for number in range(3):
        stream.outbox.put(A, message(f"a{number}."), 1)
    assert stream.resume() == ["big1", "big2", "a2.0"]


async def test_sender_may_continue_when_the_queue_is_empty() -> None:
    stream = Stream()
    stream.outbox.pause()
    for number in range(HIGH_WATER):
        assert stream.outbox.wait_for_room(A) is None
        stream.outbox.put(A, message(str(number)), None)
    room = stream.outbox.wait_for_room(A)
    assert room is not None
    assert stream.outbox.wait_for_room(A) is room
    assert stream.outbox.wait_for_room(B) is None
    stream.resume(HIGH_WATER - 1)
    assert not room.done()
    stream.resume()
    assert room.done()
    assert stream.outbox.wait_for_room(A) is None


@pytest.mark.parametrize("end", ["discard", "clear"])
async def test_waiting_sender_is_released_when_its_queue_is_dropped(end: str) -> None:
    stream = Stream()
    stream.outbox.pause()
    for number in range(HIGH_WATER):
        stream.outbox.put(A, message(str(number)), None)
    room = stream.outbox.wait_for_room(A)
    assert room is not None
    stream.outbox.discard(A) if end == "discard" else stream.outbox.clear()
    assert room.done()
    assert stream.outbox.backlog(A) == 0


def test_messages_after_the_end_are_dropped() -> None:
    """They would be kept with the owner of the outbox."""
    stream = Stream()
    stream.outbox.clear()
    assert stream.outbox.put(A, message("a"), None) == 0
    assert stream.outbox.empty
    assert stream.written == []


def test_message_being_sent_is_dropped_when_the_stream_breaks() -> None:
    stream = Stream(2)
    stream.outbox.put(A, message("a", 5), None)
    stream.outbox.put(A, message("next"), None)
    stream.outbox.pause()
    stream.outbox.abort_current()
    assert stream.resume() == ["next0"]


def test_no_more_is_written_after_write_pauses_the_outbox() -> None:
    written: list[str] = []

    def write(piece: str) -> bool:
        written.append(piece)
        outbox.pause()
        return False

    outbox: Outbox[str] = Outbox(write)
    outbox.put(A, message("a", 3), None)
    outbox.put(B, message("b"), None)
    assert written == ["a0"]


def test_write_may_queue_further_messages() -> None:
    written: list[str] = []

    def write(piece: str) -> bool:
        written.append(piece)
        if piece == "ask0":
            outbox.put(B, message("answer"), None)
        return True

    outbox: Outbox[str] = Outbox(write)
    outbox.put(A, message("ask", 2), None)
    assert sorted(written) == ["answer0", "ask0", "ask1"]
    assert outbox.empty


def test_message_that_fails_does_not_block_its_source() -> None:
    def broken() -> Iterator[str]:
        yield "begun"
        raise ZeroDivisionError

    stream = Stream()
    with pytest.raises(ZeroDivisionError):
        stream.outbox.put(A, broken(), None)
    stream.outbox.put(B, message("b"), None)
    stream.outbox.put(A, message("a"), None)
    assert stream.written == ["begun", "b0", "a0"]
    assert stream.outbox.empty


@pytest.mark.parametrize("other", [A, B])
def test_message_that_is_put_during_a_write_comes_after_its_end(other: bytes) -> None:
    written: list[str] = []

    def write(piece: str) -> bool:
        written.append(piece)
        if piece == "a0":
            assert outbox.put(other, message("later"), None) == 0
        return True

    outbox: Outbox[str] = Outbox(write)
    outbox.put(A, message("a", 3), None)
    assert written == ["a0", "a1", "a2", "later0"]
    assert outbox.empty


def test_source_of_higher_priority_is_served_first() -> None:
    stream = Stream()
    stream.outbox.pause()
    for source, priority in ((A, Priority.LOW), (B, Priority.NORMAL), (C, Priority.HIGH)):
        stream.outbox.put(source, message(source.decode(), 2), None, priority=priority)
    assert stream.resume() == ["c0", "c1", "b0", "b1", "a0", "a1"]


def test_message_of_high_priority_is_sent_between_the_pieces_of_a_low_one() -> None:
    stream = Stream(1)
    stream.outbox.put(A, message("a", 2), None, priority=Priority.LOW)
    stream.outbox.put(C, message("c"), None, priority=Priority.HIGH)
    assert stream.resume() == ["c0", "a1"]
