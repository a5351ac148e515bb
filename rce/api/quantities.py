"""Parser of quantities with units, such as `2GiB`, `1.5 G`, `500k` and `4`."""

from __future__ import annotations

import re

from rce.errors import InvalidRequest

UNITS = {"": 1, "k": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}
UNITS |= {f"{prefix}i": 1024**power for power, prefix in enumerate(("K", "M", "G", "T"), 1)}
_QUANTITY = re.compile(r"(\d+(?:\.\d+)?) ?([kMGT]|[KMGT]i|)B?", re.ASCII)


def parse_number(text: str) -> int | float | None:
    """Return the value of a quantity, as an int if it is whole, or None if the text is not a quantity."""
    match = _QUANTITY.fullmatch(text)
    if match is None:
        return None
    amount = float(match[1]) * UNITS[match[2]]
    return int(amount) if amount.is_integer() else amount


def parse_size(text: str) -> int:
    """Return a number of bytes.

    Raises:
        InvalidRequest: The text is not a quantity or not a whole number of bytes.
    """
    amount = parse_number(text)
    if not isinstance(amount, int):
        raise InvalidRequest(f"{text!r} is not a size: write it as 512MiB, 2GiB or a number of bytes")
    return amount
