"""Errors of decoding that list the values among which there is a choice."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
import pytest
from msgspec import Meta, Struct

from rce.choices import with_choices


class Inner(Struct):
    """Value with choices."""

    restart: Annotated[Literal["", "always", "no"], Meta(description="when")] = "no"
    maybe: Literal["a", "b"] | None = None
    number: int = 0


class Outer(Struct):
    """Value with values."""

    inner: Inner | None = None
    several: list[Inner] = []
    named: dict[str, Inner] = {}


@pytest.mark.parametrize(
    ("value", "reason", "path"),
    [
        ({"inner": {"restart": "x"}}, "Invalid enum value 'x': write 'always' or 'no'", "inner.restart"),
        ({"several": [{}, {"maybe": "x"}]}, "Invalid enum value 'x': write 'a' or 'b'", "several[1].maybe"),
        ({"named": {"k": {"maybe": "x"}}}, "Invalid enum value 'x': write 'a' or 'b'", "named[...].maybe"),
        ({"inner": {"number": "x"}}, "Expected `int`, got `str`", "inner.number"),
        (5, "Expected `object`, got `int`", ""),
    ],
)
def test_choices_are_listed(value: Any, reason: str, path: str) -> None:
    with pytest.raises(msgspec.ValidationError) as raised:
        msgspec.convert(value, Outer)
    assert with_choices(raised.value, Outer) == (reason, path)
