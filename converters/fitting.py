"""Values that do not fit as they are: numbers out of range, times and durations in their other spellings.

All of this is off the fast path: writers call it when packing has failed, to mend the value or to say what is wrong.
"""

from __future__ import annotations

import math
import re
import struct
from calendar import timegm
from typing import NamedTuple, TypeAlias

Value: TypeAlias = bool | int | float | str

# The last three stand for the bare tokens NaN, Infinity and -Infinity (see json_text); no string field can hold them.
_NAMES = ("NaN", "Infinity", "-Infinity")
NON_FINITE: dict[object, float] = {prefix + name: float(name) for prefix in ("", "\0") for name in _NAMES}
RANGES = {code: (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) for code, bits in zip("bhiq", (8, 16, 32, 64), strict=True)}
RANGES |= {code: (0, (1 << bits) - 1) for code, bits in zip("BHIQ", (8, 16, 32, 64), strict=True)}
PACK_ERRORS = (struct.error, OverflowError)

_ISO_TIME = re.compile(
    r"(\d{4})-(\d\d)-(\d\d)[T ](\d\d):(\d\d):(\d\d)(?:[.,](\d{1,9}))?(?:Z|([+-])(\d\d):?(\d\d))?", re.ASCII
)
_DAYS = (31, 29, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31)


class Misfit(ValueError):
    """A value that its field cannot hold. `path` grows on the way out, from the field to the message."""

    def __init__(self, reason: str, path: str = "") -> None:
        super().__init__(reason)
        self.reason = reason
        self.path = path

    def inside(self, outer: str) -> Misfit:
        self.path = join(outer, self.path)
        return self


class Pair(NamedTuple):
    """A time or duration by the attribute names of their models: seconds, nanoseconds."""

    f0: int
    f1: int


def join(outer: str, inner: str) -> str:
    return f"{outer}.{inner}" if outer and inner and not inner.startswith("[") else outer + inner


def fit(value: Value, code: str) -> Value:
    """`value` as `struct` packs it under the format `code`; Misfit if the field cannot hold it."""
    if code in "fd":
        number = NON_FINITE[value] if isinstance(value, str) else float(value)
        if code == "f" and math.isfinite(number) and abs(number) >= 3.4028235677973366e38:  # rounds to infinity
            raise Misfit(f"{number!r} is too large for float32")
        return number
    if isinstance(value, bool):
        return value
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    low, high = RANGES[code]
    if not isinstance(value, int) or not low <= value <= high:
        raise Misfit(f"expected an integer from {low} to {high}, got {shown(value)}")
    return value


def shown(value: Value) -> str:
    """`value` for an error message: short, whatever it is (Python refuses to print integers of 4301 digits)."""
    if isinstance(value, int) and value.bit_length() > 128:
        return f"an integer of {value.bit_length()} bits"
    return repr(value)[:60]


def as_pair(value: str | float) -> Pair:
    """A time in ISO 8601 or a duration in seconds, as seconds and nanoseconds."""
    return _time(value) if isinstance(value, str) else _duration(value)


def _time(text: str) -> Pair:
    """ISO 8601 with at most nine decimals; without a zone it is UTC. Years 1902 to 2038, as a message holds int32."""
    match = _ISO_TIME.fullmatch(text)
    if not match:
        raise Misfit(f"{text[:60]!r} is not a time: write 2026-11-21T10:00:00.123456 (UTC) or {{sec, nanosec}}")
    year, month, day, hour, minute, second = (int(match[i]) for i in range(1, 7))
    leap = year % 4 == 0 and (year % 100 != 0 or year % 400 == 0)
    in_month = 1 <= month <= 12 and 1 <= day <= _DAYS[month - 1] and (month != 2 or day < 29 or leap)
    if year < 1 or not in_month or hour > 23 or minute > 59 or second > 59:
        raise Misfit(f"{text[:60]!r} is not a time: there is no such date or time of day")
    seconds = timegm((year, month, day, hour, minute, second))
    if match[8]:
        offset = int(match[9]) * 3600 + int(match[10]) * 60
        seconds -= offset if match[8] == "+" else -offset
    return _checked(seconds, int((match[7] or "0").ljust(9, "0")))


def _duration(seconds: float) -> Pair:
    if not abs(seconds) < 1 << 40:  # keeps the arithmetic below exact; also true for NaN
        raise Misfit(f"expected a duration of at most 2147483647 s, got {shown(seconds)}")
    whole = math.floor(seconds)
    carry, nanoseconds = divmod(round((seconds - whole) * 1e9), 1_000_000_000)
    return _checked(whole + carry, nanoseconds)


def _checked(seconds: int, nanoseconds: int) -> Pair:
    low, high = RANGES["i"]
    if not low <= seconds <= high:
        raise Misfit(f"{seconds} s is out of range: ROS 2 holds seconds in int32")
    return Pair(seconds, nanoseconds)


def spell(value: float) -> float | str:
    """`value` for JSON, which has no non-finite numbers; other than floats pass."""
    if not isinstance(value, float) or math.isfinite(value):
        return value
    return "NaN" if value != value else "Infinity" if value > 0 else "-Infinity"
