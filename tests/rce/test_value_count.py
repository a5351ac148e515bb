"""Bound of the number of values in JSON."""

from __future__ import annotations

import msgspec
import pytest

from rce.errors import LimitExceeded
from rce.value_count import check_value_count

MOST = 10


@pytest.mark.parametrize(
    "value",
    [
        [0] * MOST,
        {f"key {i}": "text" for i in range(MOST)},
        ["a, " * 50],
        {'quoted " and, \\': "a, \\" * 50, "more": '"' * 50 + ","},
        ["\\", ",,,,,,,,,,,,", "\\\\"],
        {},
    ],
)
def test_few_values_pass(value: object) -> None:
    check_value_count(msgspec.json.encode(value), "the frame", MOST)


@pytest.mark.parametrize(
    "value",
    [
        [0] * (MOST + 2),
        [[0] * 6, [0] * 7],
        {f"key {i}": i for i in range(MOST + 2)},
        ["a, ", *["b"] * (MOST + 1)],
        [["\\"] * MOST, ['"'] * MOST],
    ],
)
def test_many_values_are_refused(value: object) -> None:
    with pytest.raises(LimitExceeded, match="the frame has more than 10 values: divide it") as caught:
        check_value_count(msgspec.json.encode(value), "the frame", MOST)
    assert caught.value.info.fields == {"values": MOST}


def test_what_is_no_json_is_counted_too() -> None:
    with pytest.raises(LimitExceeded):
        check_value_count(b'"' * 1000 + b"," * 100, "the frame", MOST)
