"""Calls and answers as pages of msgpack."""

from __future__ import annotations

import pytest
from msgspec import Raw

from rce.control.calls.watching import Log
from rce.control.pages import MALFORMED_PAGES, OVERHEAD, PAGE_SIZE, Answer, Question, decode_pages, encode, encode_pages
from rce.errors import LimitExceeded


def test_call_is_one_page_if_it_fits() -> None:
    question = Question("ReadLog", "r1", 7, encode(Log(["a line"])))
    (page,) = encode_pages(question)
    again = decode_pages([page], Question)
    assert again == question
    assert bytes(again.call) == bytes(question.call)


def test_large_answer_is_split() -> None:
    pages = encode_pages(Answer(True, encode(Log(["x" * PAGE_SIZE]))))
    assert [len(page) <= PAGE_SIZE for page in pages] == [True, True]
    assert decode_pages(pages, Answer).good


def test_value_beyond_what_the_peer_accepts_is_refused() -> None:
    with pytest.raises(LimitExceeded, match="Log has 2017 bytes, more than the 1000 that a process of this role"):
        encode(Log(["x" * 2000]), 1000 + OVERHEAD)


@pytest.mark.parametrize("pages", [[], [b"\xff"], [b"\x94", 7], ["text"], encode_pages(Answer(True, Raw(b"\xc0")))])
def test_malformed_pages_are_an_error(pages: list[bytes]) -> None:
    with pytest.raises(MALFORMED_PAGES):
        decode_pages(pages, Question)
