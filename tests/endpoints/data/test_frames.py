"""Frames of data links: messages survive any fragmentation of the stream, malformed frames are rejected."""

from __future__ import annotations

import ctypes
import itertools
import os
import random
import tracemalloc
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from endpoints.data import frames
from endpoints.data.frames import FIRST, HEAD, MAX_SENDERS, PART, FrameReader, Message, Phase, pieces
from rce.errors import LimitExceeded

SIZES = st.one_of(
    st.integers(0, 300),
    st.sampled_from([16 * 1024, 16 * 1024 + 1, PART - 1, PART, PART + 1, 2 * PART, 3 * PART + 7]),
)
ID = st.binary(min_size=16, max_size=16)


@st.composite
def messages(draw: st.DrawFn) -> Message:
    text = draw(st.text(max_size=60).filter(lambda text: len(text.encode("utf-8", "replace")) <= 255))
    text = text.encode("utf-8", "ignore").decode()
    payload = random.Random(draw(st.integers(0, 1000))).randbytes(draw(SIZES))
    error, phase, numbered = draw(st.booleans()), draw(st.sampled_from(Phase)), draw(st.booleans())
    senders = draw(st.sampled_from([(), (bytes(16),), tuple(bytes([each]) * 16 for each in range(MAX_SENDERS))]))
    if senders:
        phase = Phase.NONE
    return Message(draw(ID), text, payload, draw(st.none() | ID), error, phase, numbered, senders)


def feed(reader: FrameReader, data: bytes, cuts: itertools.cycle[int]) -> list[Message]:
    """Feed `data` to the reader as a transport would, never more than its buffer holds."""
    done: list[Message] = []
    view = memoryview(data)
    while view:
        buffer = reader.get_buffer()
        assert len(buffer) > 0
        count = min(len(buffer), len(view), next(cuts))
        buffer[:count] = view[:count]
        done += reader.buffer_updated(count)
        view = view[count:]
    return done


def plain(message: Message) -> tuple[object, ...]:
    flags = message.error, message.phase, message.numbered
    ids = message.source, message.series, message.msg_id, message.destination, message.senders
    return *ids, bytes(message.payload), flags


def received(message: Message) -> Message:
    """Return what the reader makes of a message: one of a single sender is that sender's."""
    return message.by_sender()[0] if len(message.senders) == 1 else message


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(st.data())
def test_round_trip_of_interleaved_streams_with_any_fragmentation(data: st.DataObject) -> None:
    sent = data.draw(st.lists(messages(), min_size=1, max_size=6))
    under_way = [pieces(message, stream) for stream, message in enumerate(sent)]
    wire = b""
    while under_way:
        turn = data.draw(st.integers(0, len(under_way) - 1))
        piece = next(under_way[turn], None)
        if piece is None:
            del under_way[turn]
        else:
            wire += b"".join(piece)
    cuts = itertools.cycle([1 << 16, *data.draw(st.lists(st.integers(1, 1 << 19), max_size=5))])
    got = feed(FrameReader(), wire, cuts)
    key = repr
    assert sorted(map(plain, got), key=key) == sorted(map(plain, map(received, sent)), key=key)


def test_stream_of_single_bytes() -> None:
    sent = [Message(bytes(16), "ä" * 100, b"x" * size, bytes(range(16)), True) for size in (0, 1, 17_000)]
    wire = b"".join(b"".join(piece) for stream, message in enumerate(sent) for piece in pieces(message, stream))
    assert list(map(plain, feed(FrameReader(), wire, itertools.cycle([1])))) == list(map(plain, sent))


def test_message_of_several_senders_is_that_of_each_and_what_is_made_of_it_is_common() -> None:
    message = Message(b"s" * 16, "id", b"payload", senders=(b"a" * 16, b"b" * 16))
    one, other = message.by_sender()
    assert (one.source, other.source, one.senders) == (b"a" * 16, b"b" * 16, ())
    assert one.series == other.series == b"s" * 16
    assert one.conversions is other.conversions
    assert list(one.by_sender()) == [one]


def test_large_payload_is_read_into_its_final_place() -> None:
    reader = FrameReader()
    wire = [buffer for piece in pieces(Message(bytes(16), "", bytes(3 * PART)), 1) for buffer in piece]
    reader.get_buffer()[: len(wire[0])] = wire[0]
    reader.buffer_updated(len(wire[0]))
    place = reader.get_buffer()
    assert len(place) == PART, "the rest of this frame, and nothing of the next"
    start = ctypes.addressof(ctypes.c_char.from_buffer(place))
    (message,) = feed(reader, b"".join(wire[1:]), itertools.cycle([PART]))
    assert (
        ctypes.cast(ctypes.c_char_p(bytes(message.payload)), ctypes.c_void_p).value == start
    )  # bytes() copies no bytes


def test_unknown_phase_is_refused() -> None:
    with pytest.raises(LimitExceeded, match="unknown phase"):
        feed(FrameReader(), HEAD.pack(0xE1, 0, 0, 0, 0) + bytes(16), itertools.cycle([100]))


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(st.data())
def test_hostile_bytes_raise_only_expected_errors(data: st.DataObject) -> None:
    """Random bytes, and frames with wrong heads."""
    wire = data.draw(
        st.one_of(
            st.binary(max_size=400),
            st.lists(
                st.tuples(
                    st.integers(0, 255),
                    st.integers(0, 255),
                    st.integers(0, 3),
                    st.integers(0, 2000) | st.integers(0, (1 << 32) - 1),
                    st.integers(0, 2000) | st.integers(0, (1 << 32) - 1),
                    st.binary(max_size=200),
                ),
                max_size=8,
            ).map(lambda heads: b"".join(HEAD.pack(*fields) + rest for *fields, rest in heads)),
        )
    )
    cuts = itertools.cycle(data.draw(st.lists(st.integers(1, 300), min_size=1, max_size=4)))
    reader = FrameReader()
    try:
        feed(reader, wire, cuts)
    except (LimitExceeded, UnicodeDecodeError):
        return
    assert sum(len(each.buffer) for each in reader._streams.values()) == reader._unfinished <= frames.MAX_UNFINISHED


def test_unfinished_messages_are_bounded_in_number_and_size(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frames, "MAX_UNFINISHED", 1_000_000)
    cuts = itertools.cycle([1 << 18])

    def begun(stream: int, total: int) -> bytes:
        return HEAD.pack(FIRST, 0, stream, 0, total) + bytes(16)

    for total in (1, 1000):
        reader = FrameReader()
        tracemalloc.start()
        try:
            with pytest.raises(LimitExceeded):
                feed(reader, b"".join(begun(stream, total) for stream in range(100_000)), cuts)
            assert tracemalloc.get_traced_memory()[0] < 12_000_000
        finally:
            tracemalloc.stop()
    with pytest.raises(LimitExceeded, match="unfinished one"):
        feed(FrameReader(), begun(1, 5) + begun(1, 5), cuts)
    with pytest.raises(LimitExceeded, match="belongs to no message"):
        feed(FrameReader(), begun(1, 5) + HEAD.pack(0, 0, 1, 6, 5), cuts)
    with pytest.raises(LimitExceeded, match="exceeds"):
        feed(FrameReader(), begun(1, frames.MAX_MESSAGE + 1), cuts)


def test_completed_message_frees_its_share_of_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frames, "MAX_UNFINISHED", 1_000_000)
    reader = FrameReader()
    for stream in range(5):
        message = Message(bytes(16), "", bytes(900_000))
        wire = b"".join(b"".join(piece) for piece in pieces(message, stream))
        assert len(feed(reader, wire, itertools.cycle([100_000]))) == 1


def resident() -> int:
    """Return the number of bytes of memory that this process has."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def test_announced_message_takes_memory_only_as_it_arrives() -> None:
    before, readers = resident(), [FrameReader() for _ in range(4)]
    for reader in readers:
        for stream in range(4):
            feed(reader, HEAD.pack(FIRST, 0, stream, 1, frames.MAX_MESSAGE) + bytes(17), itertools.cycle([31]))
    assert resident() - before < 20_000_000


def test_message_that_no_link_carries_is_refused_where_it_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frames, "MAX_MESSAGE", 1000)
    assert len(Message(bytes(16), "", bytes(1000)).payload) == 1000
    with pytest.raises(LimitExceeded, match="1001 bytes"):
        Message(bytes(16), "", bytes(1001))
