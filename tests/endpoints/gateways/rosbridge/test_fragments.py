"""Fragments of operations."""

from __future__ import annotations

import pytest
from msgspec import Raw

from endpoints.gateways.rosbridge.fragments import MAX_AGE, MAX_FRAGMENTED, Fragments
from endpoints.gateways.rosbridge.operations import Fragment
from rce.errors import InvalidRequest, LimitExceeded

ID = Raw(b'"x"')


def test_fragments_are_joined_in_the_order_of_their_numbers() -> None:
    fragments = Fragments(1000)
    assert fragments.add(Fragment(ID, "wor", 1, 3), 0) is None
    assert fragments.add(Fragment(ID, "hello ", 0, 3), 0) is None
    assert fragments.add(Fragment(ID, "ld", 2, 3), 0) == b"hello world"


@pytest.mark.parametrize(("number", "total"), [(-1, 2), (2, 2), (0, 0), (0, 3), (1, 2)])
def test_fragment_that_does_not_fit_is_refused(number: int, total: int) -> None:
    fragments = Fragments(1000)
    fragments.add(Fragment(ID, "a", 1, 2), 0)
    with pytest.raises(InvalidRequest):
        fragments.add(Fragment(ID, "b", number, total), 0)


def test_fragments_that_never_end_are_bounded() -> None:
    fragments = Fragments(10)
    for number in range(3):
        fragments.add(Fragment(ID, "xxx", number, 100), 0)
    with pytest.raises(LimitExceeded, match="10 characters"):
        fragments.add(Fragment(ID, "xxx", 3, 100), 0)
    assert fragments.add(Fragment(ID, "again", 0, 1), 0) == b"again", "what was forgotten does not count"
    with pytest.raises(LimitExceeded, match="at most"):
        fragments.add(Fragment(ID, "", 0, 10**9), 0)
    for number in range(MAX_FRAGMENTED):
        fragments.add(Fragment(Raw(str(number).encode()), "", 0, 2), 0)
    with pytest.raises(LimitExceeded, match="unfinished"):
        fragments.add(Fragment(ID, "", 0, 2), 0)
    fragments.sweep(MAX_AGE + 1)
    assert fragments.add(Fragment(ID, "", 0, 2), 0) is None
