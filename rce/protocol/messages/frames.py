"""Text frames: their envelope, versions and features of the protocol, and decoding."""

from __future__ import annotations

import re
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import UNSET, Meta, Raw, Struct, UnsetType

from rce.choices import with_choices
from rce.errors import InvalidRequest
from rce.protocol.known_keys import check_keys

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


MAX_LENIENT, MAX_TOKENS = 256 * 1024, 5_000  # bytes, and tokens, of a frame: some 5 ms of the event loop
# Everything up to a token that Python's json module writes for a float but that is not JSON, and the token. It matches
# at every place, so that the time is linear, and once for each token.
_TO_TOKEN = re.compile(
    rb'((?:[^"NI\-]++|"(?:[^"\\]++|\\.)*+"?|-(?!Infinity)|N(?!aN)|I(?!nfinity))*+)(NaN|-?Infinity)?', re.DOTALL
)


def _quote_token(match: re.Match[bytes]) -> bytes:
    before, token = match.groups()
    return before + b'"' + token + b'"' if token else before


def _quote_tokens(payload: bytes) -> bytes:
    """Return a frame with its tokens as strings; the same one if it has none or is too long."""
    tokens = payload.count(b"NaN") + payload.count(b"Infinity")
    if not 0 < tokens <= MAX_TOKENS or len(payload) > MAX_LENIENT:
        return payload
    return _TO_TOKEN.sub(_quote_token, payload)


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
        quoted = _quote_tokens(payload)
        if quoted != payload:
            return decode_frame(quoted)
        raise InvalidRequest(f"the frame is not a JSON object with type and data: {error}") from None


def decode_as(kind: type[T], raw: Raw | bytes, where: str, *, strict: bool = False) -> T:
    """Decode JSON as a `kind`.

    Args:
        kind: The type of the value.
        raw: The JSON.
        where: Place of the value in its frame, for the error.
        strict: Refuse keys that the value does not have.

    Raises:
        InvalidRequest: The JSON is not a `kind`; the error names `where` and the path of the wrong field.
    """
    if strict:
        check_keys(kind, raw, where)
    decoder = _decoders.get(kind)
    if decoder is None:
        decoder = _decoders[kind] = msgspec.json.Decoder(kind)
    try:
        value: T = decoder.decode(raw)
        return value
    except InvalidRequest as error:  # of a value that its type cannot describe
        raise InvalidRequest(f"{where}.{error}", field=error.info.field) from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        reason, path = with_choices(error, kind)
        raise InvalidRequest(f"{where}{'.' if path else ''}{path}: {reason}", field=path) from None
