"""Messages as Python values: dicts as JSON, bytes as blobs beside it, and the floats that JSON does not have."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import msgspec
from msgspec import UNSET

from rce.blobs import Buffer, attach, detach
from rce.errors import ConversionError, InvalidRequest
from rce.messages import DataMessage

NOT_FINITE = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}


def encode(value: Any) -> bytes:
    """JSON of a frame; numpy arrays and scalars become lists and numbers, NaN and infinities the bare tokens.

    Raises InvalidRequest for what has no JSON.
    """
    try:
        payload = _encoder.encode(value)
        if b"null" in payload:  # so msgspec writes NaN and infinities; the tokens are what every server understands
            payload = json.dumps(value, default=_plain, separators=(",", ":")).encode()
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise InvalidRequest(f"this cannot be sent as JSON: {error}") from None
    return payload


def encode_message(tag: str, type_name: str, msg_id: str, value: Any) -> tuple[bytes, dict[str, Buffer]]:
    """The text frame of a DM with `value` as its `msg`, and the blobs that belong to it."""
    wire, blobs = detach({"msg": value})
    frame: dict[str, Any] = {"type": "DM", "data": {"iTag": tag, "type": type_name, "msgID": msg_id, **wire}}
    return encode(frame), blobs


def decode_message(message: DataMessage, blobs: Mapping[str, Buffer]) -> Any:
    """The value of a DM: bytes where it is or has a blob, floats for NaN and infinities.

    These come as strings of the same name; only in a `String` message they stay strings. Raises ConversionError.
    """
    raw = message.blob if message.msg is UNSET else message.msg
    if raw is UNSET:
        raise ConversionError(f"a message of {message.iTag} came without a value", field="msg")
    key = "msg*" if message.msg is UNSET else "msg"
    text = bytes(raw)
    try:
        value = {key: msgspec.json.decode(text)}
    except RecursionError:
        raise ConversionError(f"a message of {message.iTag} is nested too deeply", field="msg") from None
    # One byte is looked for ten times as fast as two: that matters with megabytes.
    if blobs or (b"*" in text and b'*"' in text):
        attach(value, blobs)
    if not message.type.endswith("/String") and (b'NaN"' in text or b'Infinity"' in text):
        _floats(value)
    return value.get("msg")


def _plain(value: Any) -> Any:
    """Numpy's arrays and scalars, without importing numpy."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is not a type of a ROS message")


def _floats(value: Any) -> None:
    rest = [value]
    while rest:
        node = rest.pop()
        for key, item in node.items() if isinstance(node, dict) else enumerate(node):
            if isinstance(item, str):
                node[key] = NOT_FINITE.get(item, item)
            elif isinstance(item, dict | list):
                rest.append(item)


_encoder = msgspec.json.Encoder(enc_hook=_plain)
