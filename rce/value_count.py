"""Bound of the number of values in JSON that is decoded in an event loop, which waits meanwhile."""

from __future__ import annotations

from msgspec import Raw

from rce.errors import LimitExceeded

MAX_VALUES = 10_000  # they take a few milliseconds to decode


def check_value_count(data: Raw | bytes, what: str, most: int = MAX_VALUES) -> None:
    """Check that JSON does not have too many values to decode it at once.

    Args:
        data: The JSON.
        what: What it is, for the error.
        most: Maximum number of values, counted by the commas between them.

    Raises:
        LimitExceeded: It has more.
    """
    text = bytes(data)
    if text.count(b",") > most and _has_more(text, most):
        raise LimitExceeded(f"{what} has more than {most} values: divide it", values=most)


def _has_more(text: bytes, most: int) -> bool:
    """Return True if there are more than `most` commas outside the strings."""
    text = text.replace(rb"\\", b"").replace(rb"\"", b"")  # so that each quote begins or ends a string
    quotes = 4 * (most + 1)  # of a key and a value each
    pieces = text.split(b'"', quotes)
    return len(pieces) > quotes or sum(piece.count(b",") for piece in pieces[::2]) > most
