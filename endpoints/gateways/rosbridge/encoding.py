"""Operations for clients: JSON text, fragments of it, PNG and CBOR."""

from __future__ import annotations

import itertools
import math
import struct
import time
import zlib
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import cbor2
import msgspec

from endpoints.gateways.uses import Frame
from rce.errors import MALFORMED, InvalidRequest
from rce.protocol.blobs import BinaryFrame, Buffer, TextFrame

MAX_PNG = 256 * 1024  # bytes of text that are compressed; the event loop compresses about 50 MB a second
MIN_FRAGMENT = 128  # bytes
MAX_FRAGMENTS = 1000  # of one operation; a smaller size is enlarged
_numbers = itertools.count(1)


class Form(NamedTuple):
    """Encoding of the operations about one topic or service: `fragment_size` in bytes, 0 for whole ones."""

    compression: str = "none"
    fragment_size: int = 0


PLAIN = Form()


def text(**fields: object) -> bytes:
    """Return an operation as JSON."""
    return msgspec.json.encode(fields)


def with_value(name: str, value: Buffer, form: Form = PLAIN, **fields: object) -> Sequence[Frame]:
    """Return the frames of an operation whose last field is a JSON value.

    Args:
        name: Name of the last field.
        value: Its JSON, and the closing brace of the operation.
        form: How to send it.
        fields: The other fields; `Raw` is taken as it is.
    """
    head = b"%b,%b:" % (msgspec.json.encode(fields)[:-1], msgspec.json.encode(name))
    if form.compression == "none" and not form.fragment_size:
        return (TextFrame(head, value),)
    return encoded(head + value, form)


def packet(name: str, head: Buffer, data: Buffer, form: Form = PLAIN, **fields: object) -> Sequence[Frame]:
    """Return the frames of an operation whose last field is a packet of a codec.

    Args:
        name: Name of the last field.
        head: JSON of the packet, in which `data*` is the id of its data, and the closing brace of the operation.
        data: The data, which is `data` in the operation: base64 in JSON, bytes in CBOR.
        form: How to send it.
        fields: The other fields.
    """
    value: dict[str, object] = msgspec.json.decode(memoryview(head)[:-1])
    del value["data*"]
    value["data"] = bytes(data)
    if form.compression == "cbor":
        return cbor(name, cbor2.dumps(value), **fields)
    return with_value(name, msgspec.json.encode(value) + b"}", form, **fields)


def encoded(operation: bytes, form: Form) -> Sequence[Frame]:
    """Return the frames of an operation given as JSON."""
    if form.compression == "png" and len(operation) <= MAX_PNG:
        operation = text(op="png", data=b64encode(png(operation)).decode())
    if form.fragment_size and len(operation) > form.fragment_size:
        size = max(form.fragment_size, MIN_FRAGMENT, len(operation) // MAX_FRAGMENTS)
        return list(_fragments(operation.decode(), size))
    return (operation,)


def _fragments(operation: str, size: int) -> Iterator[bytes]:
    total, id = math.ceil(len(operation) / size), str(next(_numbers))
    for number in range(total):
        part = operation[number * size : (number + 1) * size]
        yield text(op="fragment", id=id, data=part, num=number, total=total)


def png(data: bytes) -> bytes:
    """Return a PNG (RGB, about square) whose pixels are these bytes and newlines after them, as rosbridge does."""
    width = math.ceil(math.sqrt(len(data) / 3)) or 1
    height = math.ceil(len(data) / 3 / width) or 1
    row = width * 3
    padded = data.ljust(row * height, b"\n")
    rows = b"".join(b"\0" + padded[start : start + row] for start in range(0, len(padded), row))
    head = struct.pack("!IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = (b"IHDR", head), (b"IDAT", zlib.compress(rows, 1)), (b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        len(content).to_bytes(4) + kind + content + zlib.crc32(kind + content).to_bytes(4) for kind, content in chunks
    )


def cbor(name: str, value: Buffer, **fields: object) -> Sequence[Frame]:
    """Return the frame of an operation whose last field is a value in CBOR."""
    return (BinaryFrame(_cbor_head(name, fields), memoryview(value)),)


def _cbor_head(name: str, fields: Mapping[str, object]) -> bytes:
    """Return a map of these fields up to the value of the last one."""
    head = bytes([0xA0 | len(fields) + 1]) + b"".join(cbor2.dumps(each) for pair in fields.items() for each in pair)
    return head + cbor2.dumps(name)


def cbor_raw(cdr: Buffer, **fields: object) -> Sequence[Frame]:
    """Return the frame of an operation with a serialized message, and the time at which it came."""
    seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
    length = len(cdr)
    code, size = next((code, size) for code, size in ((88, 1), (89, 2), (90, 4)) if length < 1 << 8 * size)
    head = b"\xa3" + b"".join(map(cbor2.dumps, ("secs", seconds, "nsecs", nanoseconds, "bytes")))
    head = _cbor_head("msg", fields) + head + bytes([code]) + length.to_bytes(size)
    return (BinaryFrame(head, memoryview(cdr)),)


EMPTY = msgspec.Raw(b"{}")


def as_text(raw: msgspec.Raw | msgspec.UnsetType) -> str:
    """Return a JSON string as it is, and other JSON as text.

    Raises:
        InvalidRequest: It is not UTF-8.
    """
    if isinstance(raw, msgspec.UnsetType):
        return ""
    text = bytes(raw)
    try:
        return str(msgspec.json.decode(text)) if text.startswith(b'"') else text.decode()
    except MALFORMED as error:
        raise InvalidRequest(f"the text is malformed: {error}") from None


def object_of(values: bytes, names: Sequence[str]) -> bytes:
    """Return a JSON list as an object with these names.

    Raises:
        InvalidRequest: There are more values than names.
    """
    items: list[msgspec.Raw] = msgspec.json.decode(values, type=list[msgspec.Raw])
    if len(items) > len(names):
        raise InvalidRequest(f"{len(items)} arguments were given, and the request has {len(names)} fields")
    return msgspec.json.encode(dict(zip(names, items, strict=False)))
