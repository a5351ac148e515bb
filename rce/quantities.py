"""Amounts as people write them: `2GiB`, `1.5 G`, `500k`, `4`."""

from __future__ import annotations

import re

from rce.errors import InvalidRequest

UNITS = {"": 1, "k": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}
UNITS |= {f"{prefix}i": 1024**power for power, prefix in enumerate(("K", "M", "G", "T"), 1)}
_QUANTITY = re.compile(r"(\d+(?:\.\d+)?) ?([kMGT]|[KMGT]i|)B?")


def number(text: str) -> int | float | None:
    """The number that is meant, None if it is none."""
    match = _QUANTITY.fullmatch(text)
    if match is None:
        return None
    amount = float(match[1]) * UNITS[match[2]]
    return int(amount) if amount.is_integer() else amount


def size(text: str) -> int:
    """Bytes. InvalidRequest."""
    amount = number(text)
    if not isinstance(amount, int):
        raise InvalidRequest(f"{text!r} is not a size: write it as 512MiB, 2GiB or a number of bytes")
    return amount
