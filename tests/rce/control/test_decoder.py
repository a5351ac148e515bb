"""Decoding of Banana within limits."""

from __future__ import annotations

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from twisted.spread.banana import encode

from rce.control.decoder import INCOMPLETE, MAX_DEPTH, Decoder, MalformedMessage

ITEMS = st.recursive(
    st.binary() | st.integers(-(2**440), 2**440) | st.floats(allow_nan=False),
    lambda inner: st.lists(inner),
    max_leaves=20,
)


def decoder(max_bytes: int = 1_000_000, max_items: int = 1000) -> Decoder:
    return Decoder(max_bytes, max_items)


@given(st.lists(ITEMS, max_size=4), st.integers(1, 50))
def test_messages_are_decoded_however_the_bytes_arrive(messages: list[object], step: int) -> None:
    data = b"".join(map(encode, messages))
    tested, found = decoder(), []
    for start in range(0, len(data), step):
        tested.feed(data[start : start + step])
        while (message := tested.next()) is not INCOMPLETE:
            found.append(message)
    assert found == messages


def test_word_of_the_vocabulary() -> None:
    tested = decoder()
    tested.feed(b"\x01\x80\x1b\x87")
    assert tested.next() == [b"answer"]


PAGE = b"\x00\x00\x1e\x82" + bytes(0x78000)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"\x01\x80" * (MAX_DEPTH + 1), "nested too deeply"),
        (b"\x00\x10\x80", "too many items"),
        (b"\x02\x80" + b"\x40\x07\x80" + b"\x01\x81" * 960 + b"\x40\x80" + b"\x01\x81" * 64, "too many items"),
        (b"\x00\x00\x40\x82", "a string is too long"),
        (b"\x01" * 65, "a number is too long"),
        (b"\x03\x80" + PAGE + PAGE + PAGE, "too large"),
        (b"\x03\x80" + PAGE + PAGE + PAGE[:90_000], "too large"),
        (b"\x7f\x87", "no message"),
        (b"\xff", "no message"),
    ],
    ids=["deep", "long list", "many items", "long string", "long number", "large", "large part", "word", "type"],
)
def test_message_beyond_the_limits_is_refused(data: bytes, reason: str) -> None:
    tested = decoder()
    tested.feed(data)
    with pytest.raises(MalformedMessage, match=reason):
        tested.next()


@pytest.mark.parametrize(
    "data", [b"\x00\x07\x80" + b"\x01\x81" * 800, b"\x01" * 64, PAGE[:1000]], ids=["list", "number", "string"]
)
def test_part_of_a_message_is_incomplete(data: bytes) -> None:
    tested = decoder()
    tested.feed(data)
    assert tested.next() is INCOMPLETE


def test_size_and_items_of_each_message_are_counted() -> None:
    tested = decoder()
    tested.feed(encode([b"abc", [1, 2]]) + encode(7))
    tested.next()
    assert (tested.size, tested.items) == (2 + 5 + 2 + 4, 5)
    tested.next()
    assert (tested.size, tested.items) == (2, 1)


def test_time_is_linear_in_the_number_of_items() -> None:
    """Twisted's decoder copies the rest of its buffer for each item: 1.3 MB/s of small numbers took a whole core."""

    def seconds(count: int) -> float:
        tested = Decoder(10_000_000, 10_000_000)
        tested.feed(encode([1] * count))
        began = time.process_time()
        assert tested.next() == [1] * count
        return time.process_time() - began

    taken = [(seconds(64_000), seconds(16_000)) for _ in range(10)]
    assert min(large for large, _ in taken) < 8 * min(small for _, small in taken)
