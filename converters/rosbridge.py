"""JSON as rosbridge writes and reads it.

It writes NaN and infinities as null. It accepts null for a float, `secs` and `nsecs` of ROS 1 in times and durations,
"now" for a time, and ignores the `seq` of ROS 1 in a header. A stamp that is left out is the present time (`Models`).
"""

from __future__ import annotations

import math
import time
from typing import Any

import msgspec

from converters import json_text
from converters.definition import CODES, Shape
from converters.model import DURATION, HEADER, TIME, Member, Message
from converters.wire import Buffer

_KEYS = {"secs": "sec", "nsecs": "nanosec"}


def number(value: float) -> float | None:
    """Replace a non-finite float by None; other values are returned unchanged."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def decode(message: Message, raw: Buffer | msgspec.Raw) -> msgspec.Struct:
    """Decode JSON with the conversions of rosbridge; raises FieldError with the path of the field at fault."""
    return json_text.decode_converted(message, raw, _converted)


def _converted(message: Message, value: Any) -> Any:
    if message.name in (TIME, DURATION):
        return _time(value)
    if not isinstance(value, dict):
        return value
    members = {member.field.name: member for member in message.members}
    if message.name == HEADER:
        value = {key: item for key, item in value.items() if key != "seq"}
    return {key: _field(members[key], item) if key in members else item for key, item in value.items()}


def _time(value: Any) -> Any:
    if value == "now":
        seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
        return {"sec": seconds, "nanosec": nanoseconds}
    return {_KEYS.get(key, key): item for key, item in value.items()} if isinstance(value, dict) else value


def _field(member: Member, value: Any) -> Any:
    if member.type.shape is not Shape.SINGLE and isinstance(value, list):
        return [_item(member, item) for item in value]
    return _item(member, value)


def _item(member: Member, value: Any) -> Any:
    if member.message:
        return _converted(member.message, value)
    if value is None and CODES.get(member.type.base, " ") in "fd":
        return "NaN"
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return value
