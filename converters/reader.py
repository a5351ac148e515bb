"""Readers from CDR to structs that msgspec encodes as JSON; each type is compiled once into a chain of closures.

The steps of a type (`layout`) append its scalars and items to one flat list in the order of the fields, from which
`_builder` makes the nested structs. Byte arrays stay views of the CDR until msgspec writes them as base64. Arrays of
numbers are read in the machine's byte order, which is little endian wherever ROS 2 runs.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from itertools import compress, islice
from math import isfinite
from typing import TypeAlias

import msgspec

from converters import cbor, rosbridge
from converters import original as original_json
from converters.definition import CODES, Shape
from converters.dialect import Dialect
from converters.images import ImageFormat, Picture, PictureFormat, write_picture
from converters.layout import Item, Run, layout
from converters.model import DURATION, IMAGE, TIME, Member, Message
from converters.scalars import FieldError, json_number
from converters.wire import Outgoing

Step: TypeAlias = Callable[[memoryview, int, list[object], Outgoing], int]
Read: TypeAlias = Callable[[memoryview, int, Outgoing], tuple[object, int]]
Build: TypeAlias = Callable[[Iterator[object]], object]
Number: TypeAlias = Callable[[float], float | str | None]
Element: TypeAlias = Callable[[memoryview, int], tuple[object, int]]

_SHORT: dict[str, Callable[[int, int], object]] = {TIME: original_json.time, DURATION: original_json.duration}
_NUMBERS: dict[str, Number] = {
    "original": original_json.number,
    "rosbridge": rosbridge.number,
    "cbor": lambda value: value,
}
_LENGTH = struct.Struct("<I").unpack_from


class Readers:
    """Compiled readers of one set of messages, for one image format.

    In the dialect of the original, times, durations and non-finite floats are as its server wrote them. In CBOR,
    structs are dictionaries, and arrays of numbers are typed arrays. `number` converts floats of arrays in which some
    are not finite, in the plain dialect.
    """

    def __init__(self, image_format: ImageFormat, *, dialect: Dialect = "plain", number: Number = json_number) -> None:
        self._format = image_format
        self._short = _SHORT if dialect == "original" else {}
        self._number = _NUMBERS.get(dialect, number)
        self._cbor = dialect == "cbor"
        self._structs: dict[Message, Callable[..., object]] = {}
        self._nested: dict[Message, Read] = {}

    def top(self, message: Message) -> Read:
        """Return the reader of a message at the beginning of the buffer; a top-level image is not encoded."""
        return self._read(message, top=True)

    def nested(self, message: Message) -> Read:
        """Return the reader of a message at any position."""
        if message not in self._nested:
            read = self._read(message, top=False)
            if message.name == IMAGE and self._format != "json":  # read plainly: the file needs the stamp as numbers
                read = image_reader(Readers(self._format)._read(message, top=False), self._format)
            self._nested[message] = read
        return self._nested[message]

    def _read(self, message: Message, *, top: bool) -> Read:
        steps = [(step.path if isinstance(step, Item) else "", self._step(step)) for step in layout(message, top=top)]
        build = self._builder(message)

        def read(data: memoryview, pos: int, blobs: Outgoing) -> tuple[object, int]:
            values: list[object] = []
            path = ""
            try:
                for path, step in steps:  # noqa: B007
                    pos = step(data, pos, values, blobs)
            except struct.error:
                raise FieldError("the data ends within the message", path) from None
            except FieldError as error:
                raise error.inside(path) from None
            return build(iter(values)), pos

        return read

    def _step(self, step: Run | Item) -> Step:
        if isinstance(step, Run):
            return _run(step, self._number)
        member = step.member
        if not member.wanted:
            return _skipped(member, self._read(member.message, top=False) if member.message else None)
        if member.message is None:
            return _primitive(member, self._number, self._cbor)
        return _nested(member, self.nested(member.message))

    def _builder(self, message: Message) -> Build:
        wanted = [m for m in message.members if m.wanted]
        if message.name in self._short and len(wanted) == len(message.members):
            short = self._short[message.name]
            return lambda values: short(next(values), next(values))  # type: ignore[arg-type]
        new = self._struct(message)
        builders = [self._builder(m.inlined) if m.inlined else None for m in wanted]
        count = len(builders)
        if not any(builders):
            return lambda values: new(*islice(values, count))
        return lambda values: new(*[build(values) if build else next(values) for build in builders])

    def _struct(self, message: Message) -> Callable[..., object]:
        wanted = [m for m in message.members if m.wanted]
        if message not in self._structs and self._cbor:
            self._structs[message] = cbor.map_of([m.field.name for m in wanted])
        elif message not in self._structs:
            as_blob = IMAGE if self._format != "json" else ""
            keys = {m.attr: m.field.name + ("*" if m.type.base == as_blob else "") for m in wanted}
            fields = [(m.attr, object) for m in wanted]
            new = msgspec.defstruct(message.name.rpartition("/")[2], fields, rename=keys, gc=False)
            self._structs[message] = new
        return self._structs[message]


def image_reader(read: Read, image_format: PictureFormat) -> Read:
    """Wrap the reader of sensor_msgs/Image so that it adds the image as a blob and returns the id."""

    def read_blob(data: memoryview, pos: int, blobs: Outgoing) -> tuple[object, int]:
        image, pos = read(data, pos, blobs)
        header, height, width, encoding, is_bigendian, step, pixels = msgspec.structs.astuple(image)  # type: ignore[arg-type]
        stamp, frame_id = msgspec.structs.astuple(header)
        origin = msgspec.structs.astuple(stamp), frame_id
        picture = Picture(height, width, encoding, is_bigendian, step, pixels, *origin)
        return blobs.add(write_picture(picture, image_format)), pos

    return read_blob


def _run(run: Run, number: Number) -> Step:
    mask, unpack, size = run.mask, run.struct.unpack_from, run.struct.size
    has_floats = any(leaf.code in "fd" for leaf in run.leaves)
    wanted = [leaf.wanted for leaf in run.leaves]

    def step(data: memoryview, pos: int, values: list[object], blobs: Outgoing) -> int:
        pos += -pos & mask
        found = unpack(data, pos)
        values += found if not has_floats or isfinite(sum(found)) else map(number, found)
        return pos + size

    def step_of_some(data: memoryview, pos: int, values: list[object], blobs: Outgoing) -> int:
        some: list[object] = []
        pos = step(data, pos, some, blobs)
        values += compress(some, wanted)
        return pos

    return step if all(wanted) else step_of_some


def _length(data: memoryview, pos: int, smallest: int) -> tuple[int, int]:
    """Read a length; raises FieldError if the rest of the data cannot hold that many elements of `smallest` bytes."""
    pos += -pos & 3
    (count,) = _LENGTH(data, pos)
    pos += 4
    if count * smallest > len(data) - pos:
        raise FieldError(f"the length {count} exceeds the remaining data")
    return count, pos


def _counted(member: Member, smallest: int) -> Callable[[memoryview, int], tuple[int, int]]:
    """Return a function that reads the number of elements of an array or sequence and the position of the first."""
    size = member.type.size
    if member.type.shape is Shape.ARRAY:
        return lambda data, pos: (size, pos)

    def counted(data: memoryview, pos: int) -> tuple[int, int]:
        count, pos = _length(data, pos, smallest)
        if size and count > size:
            raise FieldError(f"the length {count} exceeds the bound {size}")
        return count, pos

    return counted


def _primitive(member: Member, number: Number, as_cbor: bool) -> Step:
    kind = member.type
    if kind.base in CODES:
        if as_cbor:
            return _array(member, CODES[kind.base], cbor.array_of("B" if kind.is_bytes else CODES[kind.base]))
        return _bytes(member) if kind.is_bytes else _numbers(member, number)
    element: Element = _wide_text if kind.base == "wstring" else _text
    if kind.shape is not Shape.SINGLE:
        return _elements(member, 4, lambda data, pos, blobs: element(data, pos))

    def single(data: memoryview, pos: int, values: list[object], blobs: Outgoing) -> int:
        value, pos = element(data, pos)
        values.append(value)
        return pos

    return single


def _nested(member: Member, read: Read) -> Step:
    if member.type.shape is not Shape.SINGLE and member.message:
        return _elements(member, member.message.smallest, read)

    def single(data: memoryview, pos: int, values: list[object], blobs: Outgoing) -> int:
        value, pos = read(data, pos, blobs)
        values.append(value)
        return pos

    return single


def _elements(member: Member, smallest: int, read: Read) -> Step:
    counted = _counted(member, smallest)

    def step(data: memoryview, pos: int, values: list[object], blobs: Outgoing) -> int:
        count, pos = counted(data, pos)
        elements: list[object] = []
        try:
            for _ in range(count):
                value, pos = read(data, pos, blobs)
                elements.append(value)
        except FieldError as error:
            raise error.inside(f"[{len(elements)}]") from None
        values.append(elements)
        return pos

    return step


def _skipped(member: Member, read: Read | None) -> Step:
    """Return the step over a field that nobody wants; `read` is the reader of its message, if it has one."""
    kind = member.type
    smallest = member.message.smallest if member.message else struct.calcsize(CODES.get(kind.base, "I"))
    counted = (lambda data, pos: (1, pos)) if kind.shape is Shape.SINGLE else _counted(member, smallest)
    unit = 2 if kind.base == "wstring" else 1

    def numbers(data: memoryview, pos: int, values: list[object], blobs: Outgoing) -> int:
        count, pos = counted(data, pos)
        pos += -pos & (smallest - 1) if count else 0
        return pos + len(_slice(data, pos, count * smallest))

    def parts(data: memoryview, pos: int, values: list[object], blobs: Outgoing) -> int:
        count, pos = counted(data, pos)
        for _ in range(count):
            if read is not None:
                pos = read(data, pos, blobs)[1]
            else:
                size, pos = _length(data, pos, unit)
                pos += size * unit
        return pos

    return numbers if kind.base in CODES else parts


def _text(data: memoryview, pos: int) -> tuple[str, int]:
    size, pos = _length(data, pos, 1)
    end = pos + size
    terminated = size and data[end - 1] == 0
    return _decoded(data[pos : end - 1 if terminated else end], "utf-8"), end


def _wide_text(data: memoryview, pos: int) -> tuple[str, int]:
    count, pos = _length(data, pos, 2)
    return _decoded(data[pos : pos + 2 * count], "utf-16-le"), pos + 2 * count


def _decoded(data: memoryview, encoding: str) -> str:
    try:
        return str(data, encoding)
    except UnicodeDecodeError as error:
        raise FieldError(f"the string is not {encoding}: {error.reason}") from None


def _bytes(member: Member) -> Step:
    counted = _counted(member, 1)

    def step(data: memoryview, pos: int, values: list[object], blobs: Outgoing) -> int:
        count, pos = counted(data, pos)
        values.append(_slice(data, pos, count))
        return pos + count

    return step


def _numbers(member: Member, number: Number) -> Step:
    code = CODES[member.type.base]
    size = struct.calcsize(code)
    counted = _counted(member, size)

    def step(data: memoryview, pos: int, values: list[object], blobs: Outgoing) -> int:
        count, pos = counted(data, pos)
        if not count:
            values.append([])
            return pos
        pos += -pos & (size - 1)
        found = _slice(data, pos, count * size).cast(code).tolist()  # type: ignore[call-overload]
        values.append(found if code not in "fd" or isfinite(sum(found)) else list(map(number, found)))
        return pos + count * size

    return step


def _array(member: Member, code: str, convert: Callable[[memoryview], object]) -> Step:
    size = struct.calcsize(code)
    counted = _counted(member, size)

    def step(data: memoryview, pos: int, values: list[object], blobs: Outgoing) -> int:
        count, pos = counted(data, pos)
        pos += -pos & (size - 1) if count else 0
        values.append(convert(_slice(data, pos, count * size)))
        return pos + count * size

    return step


def _slice(data: memoryview, pos: int, size: int) -> memoryview:
    if pos + size > len(data):
        raise FieldError("the data ends within it")
    return data[pos : pos + size]
