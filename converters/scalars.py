"""Conversion and range checks of values that cannot be packed as they are.

This is the slow path: writers call it when packing has failed, to convert the value (a time or duration in its short
form, a whole float for an integer, a non-finite float) or to report the error.
"""

from __future__ import annotations

import math
import re
import struct
from calendar import timegm
from typing import NamedTuple, TypeAlias

Value: TypeAlias = bool | int | float | str

# The names with a leading U+0000 represent bare tokens (see json_text); no ROS string can contain that character.
_NAMES = ("NaN", "Infinity", "-Infinity")
NON_FINITE: dict[object, float] = {prefix + name: float(name) for prefix in ("", "\0") for name in _NAMES}
RANGES = {code: (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) for code, bits in zip("bhiq", (8, 16, 32, 64), strict=True)}
RANGES |= {code: (0, (1 << bits) - 1) for code, bits in zip("BHIQ", (8, 16, 32, 64), strict=True)}
PACK_ERRORS = (struct.error, OverflowError)

_ISO_TIME = re.compile(
    r"(\d{4})-(\d\d)-(\d\d)[T ](\d\d):(\d\d):(\d\d)(?:[.,](\d{1,9}))?(?:Z|([+-])(\d\d):?(\d\d))?", re.ASCII
)
_DAYS = (31, 29, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31)


class FieldError(ValueError):
    """Error for a value that its field cannot hold.

    Attributes:
        reason: Description of the error.
        path: Path of the field, completed by `inside` while the exception propagates from the field to the message.
    """

    def __init__(self, reason: str, path: str = "") -> None:
        super().__init__(reason)
        self.reason = reason
        self.path = path

    def inside(self, outer: str) -> FieldError:
        """Prefix the path with that of the enclosing field; returns self."""
        self.path = join(outer, self.path)
        return self


class TimeValue(NamedTuple):
    """Time or duration in seconds and nanoseconds, with the attribute names of their models."""

    f0: int
    f1: int


def join(outer: str, inner: str) -> str:
    """Join two field paths."""
    return f"{outer}.{inner}" if outer and inner and not inner.startswith("[") else outer + inner


def packable(value: Value, code: str) -> Value:
    """Convert a value to one that `struct` can pack with the format `code`.

    Raises:
        FieldError: The field cannot hold the value.
    """
    if code in "fd":
        number = NON_FINITE[value] if isinstance(value, str) else float(value)
        if code == "f" and math.isfinite(number) and abs(number) >= 3.4028235677973366e38:  # rounds to infinity
            raise FieldError(f"{number!r} is too large for float32")
        return number
    if isinstance(value, bool):
        return value
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    low, high = RANGES[code]
    if not isinstance(value, int) or not low <= value <= high:
        raise FieldError(f"expected an integer from {low} to {high}, got {short_repr(value)}")
    return value


def short_repr(value: Value) -> str:
    """Return a short representation for error messages; Python refuses to print integers of more than 4300 digits."""
    if isinstance(value, int) and value.bit_length() > 128:
        return f"an integer of {value.bit_length()} bits"
    return repr(value)[:60]


def time_value(value: str | float) -> TimeValue:
    """Convert the short form of a time (ISO 8601) or duration (seconds); raises FieldError."""
    return _time(value) if isinstance(value, str) else _duration(value)


def _time(text: str) -> TimeValue:
    """Parse ISO 8601 with at most nine decimals, UTC without a zone. int32 limits the years to 1901 to 2038."""
    match = _ISO_TIME.fullmatch(text)
    if not match:
        raise FieldError(f"{text[:60]!r} is not a time: write 2026-11-21T10:00:00.123456 (UTC) or {{sec, nanosec}}")
    year, month, day, hour, minute, second = (int(match[i]) for i in range(1, 7))
    leap = year % 4 == 0 and (year % 100 != 0 or year % 400 == 0)
    in_month = 1 <= month <= 12 and 1 <= day <= _DAYS[month - 1] and (month != 2 or day < 29 or leap)
    if year < 1 or not in_month or hour > 23 or minute > 59 or second > 59:
        raise FieldError(f"{text[:60]!r} is not a time: there is no such date or time of day")
    seconds = timegm((year, month, day, hour, minute, second))
    if match[8]:
        offset = int(match[9]) * 3600 + int(match[10]) * 60
        seconds -= offset if match[8] == "+" else -offset
    return _checked(seconds, int((match[7] or "0").ljust(9, "0")))


def _duration(seconds: float) -> TimeValue:
    if not abs(seconds) < 1 << 40:  # keeps the arithmetic below exact; also true for NaN
        raise FieldError(f"expected a duration of at most 2147483647 s, got {short_repr(seconds)}")
    whole = math.floor(seconds)
    carry, nanoseconds = divmod(round((seconds - whole) * 1e9), 1_000_000_000)
    return _checked(whole + carry, nanoseconds)


def _checked(seconds: int, nanoseconds: int) -> TimeValue:
    low, high = RANGES["i"]
    if not low <= seconds <= high:
        raise FieldError(f"{seconds} s is out of range: seconds are int32 in ROS 2")
    return TimeValue(seconds, nanoseconds)


def json_number(value: float) -> float | str:
    """Replace a non-finite float, which JSON does not have, by its name; other values are returned unchanged."""
    if not isinstance(value, float) or math.isfinite(value):
        return value
    return "NaN" if value != value else "Infinity" if value > 0 else "-Infinity"
