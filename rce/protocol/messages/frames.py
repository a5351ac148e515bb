"""Text frames: their envelope, versions and features of the protocol, and decoding."""

from __future__ import annotations

import re
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import UNSET, Meta, Raw, Struct, UnsetType

from rce.errors import InvalidRequest

CURRENT_VERSION = "20130902"
MINIMAL_VERSION = "20130415"
FEATURES = frozenset({"ack", "events", "resume", "parts"})

T = TypeVar("T")
FrameId = Annotated[str, Meta(max_length=255)] | int


class Frame(Struct, frozen=True):
    """Text frame of any type; its `data` is not decoded yet."""

    type: str
    data: Raw
    id: FrameId | UnsetType = UNSET


_frame = msgspec.json.Decoder(Frame)
_decoders: dict[type[Any], msgspec.json.Decoder[Any]] = {}


# A string, or a token that Python's json module writes for a float but that is not JSON.
_STRING_OR_TOKEN = re.compile(rb'"(?:[^"\\]|\\.)*+"|-?Infinity|NaN')


def _quote_token(match: re.Match[bytes]) -> bytes:
    token = match[0]
    return token if token.startswith(b'"') else b'"' + token + b'"'


def decode_frame(payload: bytes) -> Frame:
    """Decode the envelope of a text frame.

    Old Python clients send the bare tokens NaN and Infinity. They are decoded as the strings "NaN" and "Infinity",
    which represent these values everywhere else.

    Raises:
        InvalidRequest: The payload is not a text frame.
    """
    try:
        return _frame.decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        if b"NaN" in payload or b"Infinity" in payload:
            quoted = _STRING_OR_TOKEN.sub(_quote_token, payload)
            if quoted != payload:
                return decode_frame(quoted)
        raise InvalidRequest(f"the frame is not a JSON object with type and data: {error}") from None


def decode_as(kind: type[T], raw: Raw | bytes, where: str) -> T:
    """Decode JSON as a `kind`.

    Args:
        kind: The type of the value.
        raw: The JSON.
        where: Place of the value in its frame, for the error.

    Raises:
        InvalidRequest: The JSON is not a `kind`; the error names `where` and the path of the wrong field.
    """
    decoder = _decoders.get(kind)
    if decoder is None:
        decoder = _decoders[kind] = msgspec.json.Decoder(kind)
    try:
        value: T = decoder.decode(raw)
        return value
    except InvalidRequest as error:  # of a value that its type cannot describe
        raise InvalidRequest(f"{where}.{error}", field=error.info.field) from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        reason, _, path = str(error).partition(" - at `$")
        path = path.rstrip("`").lstrip(".")
        raise InvalidRequest(f"{where}{'.' if path else ''}{path}: {reason}", field=path) from None
