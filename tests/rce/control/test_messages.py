"""Calls and answers in Banana, beside Twisted's encoder and the decoder of single items."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from twisted.spread import banana

from rce.control import messages
from rce.control.decoder import INCOMPLETE, Decoder, MalformedMessage

NUMBERS = st.integers(0, 2**31 - 1)  # for larger ones Twisted has another type
WORDS = frozenset(banana.Banana.outgoingVocabulary)  # which Twisted replaces by their numbers, also in pages
PAGES = st.lists(st.binary(max_size=300).filter(lambda page: page not in WORDS), max_size=3)


def by_twisted(message: list[object]) -> bytes:
    encoder = banana.Banana()
    encoder.setPrefixLimit(64)
    encoder.currentDialect = b"pb"
    parts: list[bytes] = []
    encoder._encode(message, parts.append)
    return b"".join(parts)


def call(request: int, receiver: int, pages: list[bytes]) -> list[object]:
    return [b"message", request, receiver, b"call", 1, [b"tuple", *pages], [b"dictionary"]]


def decode(decoder: Decoder, data: bytes, step: int) -> object:
    """Feed data in pieces; return what comes last."""
    message: object = INCOMPLETE
    for start in range(0, len(data), step):
        decoder.feed(data[start : start + step])
        message = decoder.next()
    return message


@given(NUMBERS, NUMBERS, PAGES)
def test_bytes_are_those_of_twisted(request: int, receiver: int, pages: list[bytes]) -> None:
    assert messages.encode_call(request, receiver, pages) == by_twisted(call(request, receiver, pages))
    assert messages.encode_answer(request, pages) == by_twisted([b"answer", request, [b"tuple", *pages]])


@given(NUMBERS, NUMBERS, st.binary(max_size=300), st.binary(max_size=5))
def test_messages_of_one_page_are_decoded_as_a_whole(request: int, receiver: int, page: bytes, before: bytes) -> None:
    for data, message, items in (
        (messages.encode_call(request, receiver, [page]), call(request, receiver, [page]), 11),
        (messages.encode_answer(request, [page]), [b"answer", request, [b"tuple", page]], 6),
    ):
        found = messages.decode(bytearray(before + data + b"\x80"), len(before))
        assert found == messages.Decoded(message, items, len(before + data))
        for size in range(len(data)):
            assert messages.decode(bytearray(data[:size]), 0) is None


@pytest.mark.parametrize("pages", [[], [b"one", b"two"]], ids=["none", "two"])
def test_other_messages_are_decoded_by_items(pages: list[bytes]) -> None:
    data = messages.encode_call(300, 7, pages)
    assert messages.decode(bytearray(data), 0) is None
    decoder = Decoder(1000, 100)
    decoder.feed(data)
    assert decoder.next() == call(300, 7, pages)


@pytest.mark.parametrize("data", [messages.encode_call(300, 7, [b"x" * 50]), messages.encode_answer(300, [b"x" * 50])])
def test_limits_hold_however_the_bytes_arrive(data: bytes) -> None:
    sizes = set()
    for step in (1, len(data)):
        decoder = Decoder(len(data), 11)
        assert decode(decoder, data, step) is not INCOMPLETE
        sizes.add((decoder.size, decoder.items))
    ((size, items),) = sizes
    assert size == len(data)
    for max_bytes, max_items in ((size - 1, items), (size, items - 1)):
        for step in (1, len(data)):
            decoder = Decoder(max_bytes, max_items)
            with pytest.raises(MalformedMessage):
                decode(decoder, data, step)


@pytest.mark.parametrize("request_number", [2**31, 2**40])
def test_number_of_a_connection_that_has_made_many_calls(request_number: int) -> None:
    decoder = Decoder(1000, 100)
    decoder.feed(messages.encode_answer(request_number, [b"page"]))
    assert decoder.next() == [b"answer", request_number, [b"tuple", b"page"]]


def test_page_above_the_limit_of_banana_is_refused() -> None:
    decoder = Decoder(10_000_000, 100)
    decoder.feed(messages.encode_answer(1, [bytes(banana.SIZE_LIMIT + 1)]))
    with pytest.raises(MalformedMessage, match="a string is too long"):
        decoder.next()


def test_pages_of_a_part() -> None:
    assert messages.pages_of([b"tuple", b"one", b"two"]) == (b"one", b"two")
    assert messages.pages_of([b"tuple"]) == ()
    for other in ([], b"tuple", 7, [b"list", b"one"], [b"tuple", 7], [b"tuple", [b"one"]]):
        assert messages.pages_of(other) is None
