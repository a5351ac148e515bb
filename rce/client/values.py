"""Conversion between Python values and frames: dicts as JSON, bytes as blobs, and NaN and infinities."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import msgspec
from msgspec import UNSET

from rce.errors import ConversionError, InvalidRequest
from rce.protocol.blobs import STAR, Buffer, attach, detach
from rce.protocol.messages import DataMessage

NOT_FINITE = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}


def encode(value: Any) -> bytes:
    """Encode a value as JSON; numpy arrays become lists, NaN and infinities the bare tokens of Python's json.

    Raises:
        InvalidRequest: A value has no JSON representation.
    """
    try:
        payload = _encoder.encode(value)
        if b"null" in payload:  # msgspec writes NaN and infinities as null; every server understands the tokens
            payload = json.dumps(value, default=_plain, separators=(",", ":")).encode()
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise InvalidRequest(f"the value cannot be sent as JSON: {error}") from None
    return payload


def encode_message(tag: str, type_name: str, msg_id: str, value: Any) -> tuple[bytes, dict[str, Buffer]]:
    """Return the text frame of a DM with `value` as its `msg`, and the blobs to which it refers."""
    wire, blobs = detach({"msg": value})
    frame: dict[str, Any] = {"type": "DM", "data": {"iTag": tag, "type": type_name, "msgID": msg_id, **wire}}
    return encode(frame), blobs


def decode_message(message: DataMessage, blobs: Mapping[str, Buffer]) -> Any:
    """Return the value of a DM, with bytes in place of blob references and floats for NaN and infinities.

    The platform sends NaN and infinities as strings of that name. In a `String` message they stay strings.

    Raises:
        ConversionError: The message has no value or is nested too deeply.
    """
    raw = message.blob if message.msg is UNSET else message.msg
    if raw is UNSET:
        raise ConversionError(f"a message for {message.iTag} has neither msg nor msg*", field="msg")
    key = "msg*" if message.msg is UNSET else "msg"
    text = bytes(raw)
    try:
        value = {key: msgspec.json.decode(text)}
    except RecursionError:
        raise ConversionError(f"a message for {message.iTag} is nested too deeply", field="msg") from None
    if blobs or (STAR in text and b'*"' in text):
        attach(value, blobs)
    if not message.type.endswith("/String") and (b'NaN"' in text or b'Infinity"' in text):
        _floats(value)
    return value.get("msg")


def _plain(value: Any) -> Any:
    """Convert numpy arrays and scalars, without importing numpy."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is not a type that ROS messages have")


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
