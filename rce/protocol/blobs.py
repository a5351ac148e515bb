"""Binary blobs: references to them in text frames, and the binary frames that carry them.

A key that ends in `*` refers to blobs: its value is an id of 32 hex digits, or a list of ids. The blobs come before or
after the text frame as binary frames `id | bytes`; with the feature `parts` as `id | offset 4 | total 4 | bytes`
(big-endian), so that small frames can be sent between the parts of a large blob. `rce.protocol.assembler` joins text
frames and their blobs.
"""

from __future__ import annotations

import re
import struct
import uuid
from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from typing import Any, NamedTuple

from msgspec import Raw

from rce.errors import InvalidRequest, LimitExceeded

PART = 256 * 1024  # bytes
ID_SIZE = 32
# Last byte of a key that refers to blobs: a text is searched for one byte ten times as fast as for two. It is a number,
# because CPython makes and drops an exception before it searches for bytes.
STAR = ord("*")
Buffer = bytes | bytearray | memoryview

POSITION = struct.Struct("!II")  # offset and total, with `parts`

_id = re.compile(rb"[0-9a-fA-F]{32}")
# In valid JSON a quote inside a string is escaped, so `*"` always ends a string, and one before a colon is a key.
_key = re.compile(rb'\*"[ \t\n\r]*+:[ \t\n\r]*+')
_value = re.compile(
    rb'"[0-9a-fA-F]{32}"|\[[ \t\n\r]*+(?:"[0-9a-fA-F]{32}"[ \t\n\r]*+(?:,[ \t\n\r]*+"[0-9a-fA-F]{32}"[ \t\n\r]*+)*+)?\]'
)


class TextFrame(NamedTuple):
    """Text message in two parts, so that the large one is not copied."""

    head: bytes
    data: Buffer

    def join(self) -> bytes:
        """Return the message in one piece."""
        return b"".join(self)


def find_references(data: Raw | bytes, limit: int = 1 << 30) -> list[str]:
    """Return the ids of all blobs that valid JSON refers to at any depth, each once and in order, in linear time.

    Raises:
        InvalidRequest: The value of a `key*` is neither an id nor a list of ids.
        LimitExceeded: There are more than `limit` references.
    """
    text = memoryview(data)
    found: list[str] = []
    for key in _key.finditer(text):
        value = _value.match(text, key.end())
        if value is None:
            name = bytes(text[max(0, key.start() - 40) : key.start() + 1]).rpartition(b'"')[2].decode(errors="replace")
            raise InvalidRequest(f"{name!r} must hold a blob id (32 hex digits) or a list of ids", field=name)
        found += (match[0].decode() for match in islice(_id.finditer(value[0]), limit - len(found) + 1))
        if len(found) > limit:
            raise LimitExceeded(f"the message refers to more than {limit} blobs", blobs=limit)
    return list(dict.fromkeys(found))


def attach(value: Any, blobs: Mapping[str, Buffer]) -> Any:
    """Replace the references in decoded JSON by the blobs, as bytes: `key*` becomes `key`. Changes `value` in place."""
    rest = [value] if isinstance(value, dict | list) else []
    while rest:
        node = rest.pop()
        if isinstance(node, dict):
            for key in [key for key in node if key.endswith("*")]:
                _attach(node, key, blobs)
        rest += (item for item in (node.values() if isinstance(node, dict) else node) if isinstance(item, dict | list))
    return value


def _attach(node: dict[str, Any], key: str, blobs: Mapping[str, Buffer]) -> None:
    reference = node[key]
    ids = reference if isinstance(reference, list) else [reference]
    if all(isinstance(name, str) and name in blobs for name in ids):
        found = [bytes(blobs[name]) for name in ids]
        del node[key]
        node[key[:-1]] = found if reference is ids else found[0]


def detach(value: Any, where: str = "") -> tuple[Any, dict[str, Buffer]]:
    """Replace the blobs in a value by references with new ids (`key` becomes `key*`).

    Blobs are the bytes-like values of objects, and their lists of bytes-like values only.

    Args:
        value: The value, which is not changed.
        where: Path of the value, for the error.

    Returns:
        The new value, and the blobs by id.

    Raises:
        InvalidRequest: A blob is neither the value of a key nor in a list of blobs.
    """
    blobs: dict[str, Buffer] = {}
    return _detach(value, where, blobs), blobs


def _detach(value: Any, where: str, blobs: dict[str, Buffer]) -> Any:
    if isinstance(value, list | tuple):
        if value and isinstance(value[0], int | float | str):
            return value  # an array of numbers or strings has no blobs
        return [_detach(item, f"{where}[{index}]", blobs) for index, item in enumerate(value)]
    if isinstance(value, Buffer):
        raise InvalidRequest(
            f"{where}: a blob must be the value of a key, or an item of a list that has blobs only", field=where
        )
    if not isinstance(value, dict):
        return value
    result: dict[str, Any] = {}
    for key, item in value.items():
        if isinstance(item, Buffer):
            result[key + "*"] = _keep(item, blobs)
        elif isinstance(item, list | tuple) and item and all(isinstance(each, Buffer) for each in item):
            result[f"{key}*"] = [_keep(each, blobs) for each in item]
        else:
            result[key] = _detach(item, f"{where}.{key}" if where else key, blobs)
    return result


def _keep(blob: Buffer, blobs: dict[str, Buffer]) -> str:
    name = uuid.uuid4().hex
    blobs[name] = blob if isinstance(blob, bytes) else bytes(blob)  # a mutable or non-contiguous buffer is copied
    return name


class BinaryFrame(NamedTuple):
    """Frame that carries a blob or a part of one. Its head and its data are separate, which avoids a copy."""

    head: bytes
    data: memoryview

    def join(self) -> bytes:
        """Return the whole frame."""
        return b"".join(self)


def binary_frames(
    blobs: Mapping[str, Buffer], parts: bool, size: Callable[[], int] = lambda: PART
) -> Iterator[BinaryFrame]:
    """Yield the binary frames that carry these blobs; with `parts`, in parts.

    Args:
        blobs: The blobs by id.
        parts: Divide large blobs.
        size: Returns the number of bytes of the next part.
    """
    for name, blob in blobs.items():
        view = memoryview(blob).cast("B")
        if not parts:
            yield BinaryFrame(name.encode(), view)
            continue
        offset = 0
        while True:
            end = offset + size()
            yield BinaryFrame(name.encode() + POSITION.pack(offset, len(view)), view[offset:end])
            if end >= len(view):
                break
            offset = end
