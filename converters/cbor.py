"""CBOR of rosbridge (RFC 8949): maps by field names, byte strings, and arrays of numbers as typed arrays (RFC 8746)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import cbor2

TAGS = {
    "b": 72,
    "H": 69,
    "I": 70,
    "Q": 71,
    "h": 77,
    "i": 78,
    "q": 79,
    "f": 85,
    "d": 86,
}  # little endian; of uint8: none


def map_of(names: Sequence[str]) -> Callable[..., dict[str, Any]]:
    """Return a function that makes a map of the values of these fields."""
    return lambda *values: dict(zip(names, values, strict=True))


def array_of(code: str) -> Callable[[memoryview], object]:
    """Return a function that makes the array of numbers whose bytes it is given; `code` is their format in `struct`."""
    if code == "B":
        return bytes
    if code == "?":
        return lambda data: list(map(bool, data))
    tag = TAGS[code]
    return lambda data: cbor2.CBORTag(tag, bytes(data))


def encode(value: object) -> bytes:
    """Return a value as CBOR."""
    return cbor2.dumps(value)
