"""The parts of a message that have no fixed size: strings, byte arrays, numbers; and what came as a blob."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from operator import attrgetter
from typing import TypeAlias

import msgspec
from msgspec import UNSET

from converters.definition import CODES, FieldType, Shape
from converters.fitting import NON_FINITE, PACK_ERRORS, Misfit, Pair, Value, fit
from converters.layout import Item
from converters.wire import Buffer, Incoming

Source: TypeAlias = msgspec.Struct | Pair | str | float  # times and durations may still be in their short spelling
Write: TypeAlias = Callable[[Source, list[Buffer], int, Incoming], int]

LENGTHS = tuple(struct.Struct(f"<{n}xI").pack for n in range(4))  # by the padding before a length


def getter(item: Item, decode: Callable[[Buffer], object] | None) -> Callable[[Source, Incoming], object]:
    """The value of an item; what came as a blob in place of it is fetched, and decoded by `decode`."""
    get = attrgetter(".".join(item.attrs))
    if not item.member.takes_blob:
        return lambda source, blobs: get(source)
    get_id = attrgetter(".".join(item.attrs) + "b")

    def fetch(blob_id: str, blobs: Incoming) -> object:
        blob = blobs.take(blob_id)
        return decode(blob) if decode else blob

    def value(source: Source, blobs: Incoming) -> object:
        ids = get_id(source)
        if ids is UNSET:
            return get(source)
        try:
            return fetch(ids, blobs) if isinstance(ids, str) else [fetch(one, blobs) for one in ids]
        except Misfit as error:
            raise error.inside(item.path + "*") from None

    return value


def start(kind: FieldType, values: Sequence[object], parts: list[Buffer], pos: int, path: str) -> int:
    """The length before a sequence. Lengths of lists were checked while parsing, those of blobs and base64 were not."""
    count = len(values)
    if kind.size and (count > kind.size or (kind.shape is Shape.ARRAY and count < kind.size)):
        raise Misfit(
            f"expected {'' if kind.shape is Shape.ARRAY else 'at most '}{kind.size} elements, got {count}", path
        )
    if kind.shape is Shape.ARRAY:
        return pos
    padding = -pos & 3
    parts.append(LENGTHS[padding](count))
    return pos + padding + 4


def primitive(item: Item) -> Write:
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
    if b"\0" in data:
        raise Misfit("a ROS string cannot hold the character U+0000", path)
    if bound and len(data) > bound:
        raise Misfit(f"expected at most {bound} bytes of UTF-8, got {len(data)}", path)
    padding = -pos & 3
    parts += (LENGTHS[padding](len(data) + 1), data, b"\0")
    return pos + padding + 5 + len(data)


def _wide_text(value: str, bound: int, parts: list[Buffer], pos: int, path: str) -> int:
    """Fast CDR: the number of UTF-16 units, then the units, no terminator."""
    data = value.encode("utf-16-le")
    if bound and len(data) > 2 * bound:
        raise Misfit(f"expected at most {bound} UTF-16 units, got {len(data) // 2}", path)
    padding = -pos & 3
    parts += (LENGTHS[padding](len(data) // 2), data)
    return pos + padding + 4 + len(data)


def _bytes(item: Item) -> Write:
    kind, path, get = item.member.type, item.path, getter(item, None)

    def write(source: Source, parts: list[Buffer], pos: int, blobs: Incoming) -> int:
        value: Buffer | list[Value] = get(source, blobs)  # type: ignore[assignment]
        data = _fitted(value, "B", 0, path) if isinstance(value, list) else value
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
            data = _fitted(values, code, -pos & mask, path)
            parts.append(data)
            pos += len(data)
        return pos

    return write


def _fitted(values: Sequence[Value], code: str, padding: int, path: str) -> bytes:
    form = f"<{padding}x{len(values)}{code}"
    with suppress(*PACK_ERRORS):
        return struct.pack(form, *values)
    if code in "fd":
        with suppress(*PACK_ERRORS):
            return struct.pack(form, *[NON_FINITE.get(value, value) for value in values])
    return struct.pack(form, *[_fitted_one(value, code, f"{path}[{i}]") for i, value in enumerate(values)])


def _fitted_one(value: Value, code: str, path: str) -> Value:
    try:
        return fit(value, code)
    except Misfit as error:
        raise error.inside(path) from None
