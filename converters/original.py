"""JSON as the original's server wrote and read it, for robots that know no other.

It wrote times as ISO 8601, durations as a number of seconds, and NaN and infinities as bare tokens. What it read, it
converted with Python's `int`, `float` and `bool`, so that "5" and 5.7 were accepted for the integer 5. It ignored
fields that the type does not have.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

import msgspec

from converters import json_text
from converters.definition import CODES, Shape
from converters.model import DURATION, TIME, Member, Message
from converters.scalars import json_number
from converters.wire import Buffer

# Non-finite floats are strings that begin with U+0000 until the message is JSON.
_MARKED = re.compile(rb'"\\u0000(NaN|-?Infinity)"')


def number(value: float) -> float | str:
    """Mark a non-finite float; return other values unchanged."""
    found = json_number(value)
    return "\0" + found if isinstance(found, str) else found


def with_bare_tokens(text: bytes) -> bytes:
    """Replace marked floats by the tokens NaN, Infinity and -Infinity."""
    return _MARKED.sub(rb"\1", text) if b'"\\u0000' in text else text


def time(seconds: int, nanoseconds: int) -> str:
    """Return a time as ISO 8601 in UTC, without decimals if they are zero."""
    whole, rest = divmod(nanoseconds, 1_000_000_000)
    moment = datetime.fromtimestamp(seconds + whole, UTC)
    return moment.replace(tzinfo=None, microsecond=rest // 1000).isoformat()


def duration(seconds: int, nanoseconds: int) -> float:
    """Return a duration in seconds."""
    return seconds + nanoseconds / 1e9


def decode(message: Message, raw: Buffer | msgspec.Raw) -> msgspec.Struct:
    """Decode JSON with the conversions of the original; raises FieldError with the path of the field at fault."""
    return json_text.decode_converted(message, raw, _converted)


def _converted(message: Message, value: Any) -> Any:
    if message.name == TIME and isinstance(value, str):
        return value
    if message.name == DURATION and not isinstance(value, dict):
        return _attempt(float, value)
    if not isinstance(value, dict):
        return value
    members = {member.field.name: member for member in message.members}
    blobs = {member.field.name + "*" for member in message.members if member.accepts_blob}
    known = {name: item for name, item in value.items() if name in members or name in blobs}
    return {name: item if name in blobs else _field(members[name], item) for name, item in known.items()}


def _field(member: Member, value: Any) -> Any:
    if member.type.shape is Shape.SINGLE:
        return _item(member, value)
    return [_item(member, item) for item in value] if isinstance(value, list) else value


def _item(member: Member, value: Any) -> Any:
    if member.message:
        return _converted(member.message, value)
    code = CODES.get(member.type.base)
    if code is None:
        return value
    return _attempt(bool if code == "?" else float if code in "fd" else int, value)


def _attempt(convert: Callable[[Any], Any], value: Any) -> Any:
    """Return the converted value, or the value itself, for which the error names the field."""
    with suppress(ValueError, TypeError, OverflowError):
        return convert(value)
    return value
