"""Quantities with units."""

from __future__ import annotations

import pytest

from rce.api.quantities import parse_number, parse_size
from rce.errors import InvalidRequest


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("4", 4),
        ("0.5", 0.5),
        ("500k", 500_000),
        ("1.5 G", 1_500_000_000),
        ("2GiB", 2 * 1024**3),
        ("1 MB", 10**6),
        ("3Ti", 3 * 1024**4),
        ("7B", 7),
    ],
)
def test_value_of_a_quantity(text: str, value: float) -> None:
    number = parse_number(text)
    assert number == value
    assert isinstance(number, type(value))


@pytest.mark.parametrize("text", ["", "much", "-1", "1  G", "1g", "1kiB", ".5", "1e3", "٣"])
def test_other_text_is_no_quantity(text: str) -> None:
    assert parse_number(text) is None


def test_size_is_a_whole_number_of_bytes() -> None:
    assert parse_size("1.5KiB") == 1536
    for text in ("0.5", "1.0001k ", "large"):
        with pytest.raises(InvalidRequest, match="512MiB"):
            parse_size(text)
