"""Writers of the items of a message: strings, byte arrays and arrays of numbers, some of them received as blobs."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from operator import attrgetter
from typing import TypeAlias

import msgspec
from msgspec import UNSET

from converters.definition import CODES, FieldType, Shape
from converters.layout import Item
from converters.scalars import NON_FINITE, PACK_ERRORS, FieldError, TimeValue, Value, packable
from converters.wire import Buffer, Incoming

Source: TypeAlias = msgspec.Struct | TimeValue | str | float  # times and durations may still be in their short form
Write: TypeAlias = Callable[[Source, list[Buffer], int, Incoming], int]

PACK_LENGTH = tuple(struct.Struct(f"<{n}xI").pack for n in range(4))  # by the padding before the length


def getter(item: Item, decode: Callable[[Buffer], object] | None) -> Callable[[Source, Incoming], object]:
    """Return a function that gets the value of an item from its message.

    A blob that was sent in place of the value is looked up and decoded with `decode`, if given.
    """
    get = attrgetter(".".join(item.attrs))
    if not item.member.accepts_blob:
        return lambda source, blobs: get(source)
    get_id = attrgetter(".".join(item.attrs) + "b")

    def fetch(blob_id: str, blobs: Incoming) -> object:
        blob = blobs.get(blob_id)
        return decode(blob) if decode else blob

    def value(source: Source, blobs: Incoming) -> object:
        ids = get_id(source)
        if ids is UNSET:
            return get(source)
        try:
            return fetch(ids, blobs) if isinstance(ids, str) else [fetch(one, blobs) for one in ids]
        except FieldError as error:
            raise error.inside(item.path + "*") from None

    return value


def start(kind: FieldType, values: Sequence[object], parts: list[Buffer], pos: int, path: str) -> int:
    """Check the number of elements and write the length of a sequence; return the position after it.

    The lengths of lists have been checked during parsing, those of blobs and base64 have not.
    """
    count = len(values)
    if kind.size and (count > kind.size or (kind.shape is Shape.ARRAY and count < kind.size)):
        raise FieldError(
            f"expected {'' if kind.shape is Shape.ARRAY else 'at most '}{kind.size} elements, got {count}", path
        )
    if kind.shape is Shape.ARRAY:
        return pos
    padding = -pos & 3
    parts.append(PACK_LENGTH[padding](count))
    return pos + padding + 4


def primitive(item: Item) -> Write:
    """Return the writer of an item that is not a nested message."""
    kind = item.member.type
    if kind.is_bytes:
        return _bytes(item)
    if kind.base in CODES:
        return _numbers(item)
    text = _wide_text if kind.base == "wstring" else _text
    bound, path, get = kind.text_bound, item.path, attrgetter(".".join(item.attrs))

    def single(source: Source, parts: list[Buffer], pos: int, blobs: Incoming) -> int:
        return text(get(source), bound, parts, pos, path)

    def several(source: Source, parts: list[Buffer], pos: int, blobs: Incoming) -> int:
        values: Sequence[str] = get(source)
        pos = start(kind, values, parts, pos, path)
        for i, value in enumerate(values):
            pos = text(value, bound, parts, pos, f"{path}[{i}]")
        return pos

    return single if kind.shape is Shape.SINGLE else several


def _text(value: str, bound: int, parts: list[Buffer], pos: int, path: str) -> int:
    data = value.encode()
    if 0 in data:
        raise FieldError("a ROS string cannot hold the character U+0000", path)
    if bound and len(data) > bound:
        raise FieldError(f"expected at most {bound} bytes of UTF-8, got {len(data)}", path)
    padding = -pos & 3
    parts += (PACK_LENGTH[padding](len(data) + 1), data, b"\0")
    return pos + padding + 5 + len(data)


def _wide_text(value: str, bound: int, parts: list[Buffer], pos: int, path: str) -> int:
    """Write a wide string as Fast CDR does: the number of UTF-16 units, then the units, without a terminator."""
    data = value.encode("utf-16-le")
    if bound and len(data) > 2 * bound:
        raise FieldError(f"expected at most {bound} UTF-16 units, got {len(data) // 2}", path)
    padding = -pos & 3
    parts += (PACK_LENGTH[padding](len(data) // 2), data)
    return pos + padding + 4 + len(data)


def _bytes(item: Item) -> Write:
    kind, path, get = item.member.type, item.path, getter(item, None)

    def write(source: Source, parts: list[Buffer], pos: int, blobs: Incoming) -> int:
        value: Buffer | list[Value] = get(source, blobs)  # type: ignore[assignment]
        data = _pack(value, "B", 0, path) if isinstance(value, list) else value
        pos = start(kind, data, parts, pos, path)
        parts.append(data)
        return pos + len(data)

    return write


def _numbers(item: Item) -> Write:
    kind, path, get = item.member.type, item.path, attrgetter(".".join(item.attrs))
    code = CODES[kind.base]
    mask = struct.calcsize(code) - 1

    def write(source: Source, parts: list[Buffer], pos: int, blobs: Incoming) -> int:
        values: Sequence[Value] = get(source)
        pos = start(kind, values, parts, pos, path)
        if values:
            data = _pack(values, code, -pos & mask, path)
            parts.append(data)
            pos += len(data)
        return pos

    return write


def _pack(values: Sequence[Value], code: str, padding: int, path: str) -> bytes:
    form = f"<{padding}x{len(values)}{code}"
    with suppress(*PACK_ERRORS):
        return struct.pack(form, *values)
    if code in "fd":
        with suppress(*PACK_ERRORS):
            return struct.pack(form, *[NON_FINITE.get(value, value) for value in values])
    return struct.pack(form, *[_packable(value, code, f"{path}[{i}]") for i, value in enumerate(values)])


def _packable(value: Value, code: str, path: str) -> Value:
    try:
        return packable(value, code)
    except FieldError as error:
        raise error.inside(path) from None
