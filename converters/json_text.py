"""JSON decoder for robots' messages: msgspec, extended by the bare tokens NaN, Infinity and -Infinity."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any, NoReturn, TypeVar

import msgspec

from converters.model import Message
from converters.scalars import FieldError
from converters.wire import Buffer

# A string, terminated or not, or a token outside of strings. Possessive quantifiers and a match at every quote give
# linear time. Every branch begins with a literal, which makes the search for the next match fast.
_TOKENS = re.compile(rb'"(?:[^"\\]++|\\.)*+"?|NaN|Infinity|-Infinity', re.DOTALL)
_WHERE = re.compile(r"(.*) - at `\$\.?(.*)`", re.DOTALL)
Model = TypeVar("Model", bound=msgspec.Struct)


def decode(decoder: msgspec.json.Decoder[Model], raw: Buffer | msgspec.Raw) -> Model:
    """Decode a message; raises FieldError with the path of the field at fault."""
    try:
        return decoder.decode(raw)
    except msgspec.ValidationError as error:
        refuse(error)
    except msgspec.DecodeError as error:
        data = bytes(raw)
        if b"NaN" not in data and b"Infinity" not in data:
            refuse(error)
        return _decode_lenient(decoder, data)
    except (UnicodeDecodeError, RecursionError) as error:
        refuse(error)


def decode_converted(
    message: Message, raw: Buffer | msgspec.Raw, convert: Callable[[Message, Any], Any]
) -> msgspec.Struct:
    """Decode a message after the conversions of a dialect; raises FieldError with the path of the field at fault."""
    try:
        return msgspec.convert(convert(message, json.loads(bytes(raw))), message.annotation)  # type: ignore[no-any-return]
    except (ValueError, RecursionError) as error:
        refuse(error)


def _decode_lenient(decoder: msgspec.json.Decoder[Model], data: bytes) -> Model:
    """Replace the tokens by strings that begin with U+0000, which float fields accept (`scalars.NON_FINITE`)."""
    try:
        return decoder.decode(_TOKENS.sub(_quoted, data))
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        refuse(error)


def _quoted(match: re.Match[bytes]) -> bytes:
    token = match[0]
    return token if token.startswith(b'"') else b'"\\u0000' + token + b'"'


def refuse(error: Exception) -> NoReturn:
    """Raise FieldError for an error of a JSON decoder."""
    if isinstance(error, UnicodeDecodeError):
        raise FieldError("the JSON is not UTF-8") from None
    if isinstance(error, RecursionError):
        raise FieldError("the JSON is nested too deeply") from None
    match = _WHERE.fullmatch(str(error))
    reason, path = (match[1], match[2]) if match else (str(error), "")
    if reason.startswith("Invalid enum value"):
        reason = f'expected a number, "NaN", "Infinity" or "-Infinity", got {reason[19:60]}'
    raise FieldError(reason[:200].replace("`", ""), path) from None
