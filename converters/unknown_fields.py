"""Errors for fields that a type does not have: they name the nearest one that it has."""

from __future__ import annotations

import difflib
import re

from converters.model import Message
from converters.scalars import FieldError, join

_UNKNOWN = re.compile(r"Object contains unknown field (.*)", re.DOTALL)  # msgspec's error, after `json_text.refuse`
_NAME = re.compile(r"[A-Za-z]\w*")
MAX_LISTED = 12  # fields of a type that an error lists


def explained(error: FieldError, message: Message) -> FieldError:
    """Return an error for an unknown field with the field that was probably meant; other errors unchanged.

    Args:
        error: The error; its path is that of the object with the field.
        message: Type of the message.
    """
    match = _UNKNOWN.fullmatch(error.reason)
    if match is None:
        return error
    inside = message
    for name in _NAME.findall(error.path):
        inside = next((m.message for m in inside.members if m.field.name == name and m.message), inside)
    names = [member.field.name for member in inside.members]
    near = difflib.get_close_matches(match[1], names, 1)
    known = f"did you mean {near[0]}?" if near else f"it has {', '.join(names[:MAX_LISTED]) or 'none'}"
    return FieldError(f"{inside.name} has no such field: {known}", join(error.path, match[1][:80]))
