"""Steps that copy messages between the serialization of ROS 1 and CDR; each type is compiled once into closures."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from itertools import groupby
from typing import NamedTuple, TypeAlias

from converters.definition import CODES, FieldType, Shape
from converters.model import Member, Message
from converters.scalars import FieldError, join
from converters.wire import Buffer
from converters.writer import PADDING
from rce.errors import InvalidRequest

HEADER = "std_msgs/msg/Header"  # begins with `uint32 seq` in ROS 1, which is 0 on the way there
LACKING: dict[str, frozenset[str]] = {
    "sensor_msgs/msg/Range": frozenset({"variance"}),
    "shape_msgs/msg/SolidPrimitive": frozenset({"polygon"}),
    "visualization_msgs/msg/Marker": frozenset({"texture_resource", "texture", "uv_coordinates", "mesh_file"}),
}
"""Fields of ROS 2 that ROS 1 does not have: they get zeros, and are left out on the way back."""

ZEROS = memoryview(bytes(1 << 10))  # ROS 1 form of a field in which all is zero or empty

Copy: TypeAlias = Callable[[memoryview, int, list[Buffer], int], tuple[int, int]]
"""Copies a part of a message: takes the input, the position in it, the output and the position in that, and returns the
positions behind the part."""

_LENGTH = struct.Struct("<I")


class _Scalar(NamedTuple):
    """Scalar of one of the two forms, or of both; `code` is its format character."""

    path: str
    code: str
    ros1: bool = True
    ros2: bool = True


class _Part(NamedTuple):
    """String, array, sequence, or message with steps of its own."""

    path: str
    member: Member
    ros1: bool


def _flat(message: Message, path: str = "", *, ros1: bool = True) -> Iterator[_Scalar | _Part]:
    """Yield the scalars and other parts of a message and of those inside that are laid out with it."""
    if message.name == HEADER:
        yield _Scalar(join(path, "seq"), "I", ros1, ros2=False)
    if not message.members:
        yield _Scalar(path, "B", ros1=False)  # the filler of empty structs
    for member in message.members:
        here = join(path, member.field.name)
        present = ros1 and member.field.name not in LACKING.get(message.name, ())
        if member.inlined is not None:
            yield from _flat(member.inlined, here, ros1=present)
        elif member.type.shape is Shape.SINGLE and member.type.base in CODES:
            yield _Scalar(here, CODES[member.type.base], present)
        else:
            yield _Part(here, member, present)


class Compiler:
    """Compiles message types into functions that copy them in one direction."""

    def __init__(self, *, to_cdr: bool) -> None:
        self._to_cdr = to_cdr
        self._chains: dict[str, Copy] = {}

    def chain(self, message: Message) -> Copy:
        """Return the function for a message type; raise InvalidRequest if ROS 1 has no such type."""
        if message.name not in self._chains:
            self._chains[message.name] = self._chain(message)
        return self._chains[message.name]

    def _chain(self, message: Message) -> Copy:
        steps: list[tuple[str, Copy]] = []
        for is_run, group in groupby(_flat(message), lambda each: isinstance(each, _Scalar)):
            found = list(group)
            if is_run:
                run = [each for each in found if isinstance(each, _Scalar)]
                steps.append((run[0].path, _run(run, to_cdr=self._to_cdr)))
            else:
                steps += [(each.path, self._part(each)) for each in found if isinstance(each, _Part)]

        def copy(data: memoryview, at: int, parts: list[Buffer], pos: int) -> tuple[int, int]:
            path = ""
            try:
                for path, step in steps:  # noqa: B007
                    at, pos = step(data, at, parts, pos)
            except struct.error:
                raise FieldError("the data ends within the message", path) from None
            except FieldError as error:
                raise error.inside(path) from None
            return at, pos

        return copy

    def _part(self, part: _Part) -> Copy:
        kind = part.member.type
        if kind.base in CODES:
            copy = self._numbers(kind)
        else:
            copy = self._one(part)
            if kind.shape is not Shape.SINGLE:
                copy = self._many(part.member, copy)
        return copy if part.ros1 else _lacking(copy, to_cdr=self._to_cdr)

    def _one(self, part: _Part) -> Copy:
        member = part.member
        if member.message is not None:
            return self.chain(member.message)
        if member.type.base == "wstring":
            raise InvalidRequest(f"{part.path} is a wstring, which ROS 1 does not have: use format cdr", field="format")
        return _text_to_cdr if self._to_cdr else _text_from_cdr

    def _start(self, kind: FieldType, smallest: int) -> Callable[[memoryview, int, list[Buffer], int], tuple[int, ...]]:
        """Return a function that copies the length of a list, and returns it before the positions."""
        size, to_cdr = kind.size, self._to_cdr
        if kind.shape is Shape.ARRAY:
            return lambda data, at, parts, pos: (size, at, pos)

        def start(data: memoryview, at: int, parts: list[Buffer], pos: int) -> tuple[int, ...]:
            count, at = _length(data, at if to_cdr else at + (-at & 3), smallest)
            if size and count > size:
                raise FieldError(f"the length {count} exceeds the bound {size}")
            return count, at, _put_length(count, parts, pos, to_cdr=to_cdr)

        return start

    def _many(self, member: Member, copy: Copy) -> Copy:
        smallest = _smallest(member.message) if member.message is not None else 4
        if not smallest:
            raise InvalidRequest(
                f"{member.field.name} is a list of empty messages, which has no form in ROS 1: use format cdr",
                field="format",
            )
        start = self._start(member.type, smallest)

        def many(data: memoryview, at: int, parts: list[Buffer], pos: int) -> tuple[int, int]:
            count, at, pos = start(data, at, parts, pos)
            for index in range(count):
                try:
                    at, pos = copy(data, at, parts, pos)
                except struct.error:
                    raise FieldError("the data ends within the message", f"[{index}]") from None
                except FieldError as error:
                    raise error.inside(f"[{index}]") from None
            return at, pos

        return many

    def _numbers(self, kind: FieldType) -> Copy:
        width = struct.calcsize(CODES[kind.base])
        mask, to_cdr, start = width - 1, self._to_cdr, self._start(kind, width)

        def numbers(data: memoryview, at: int, parts: list[Buffer], pos: int) -> tuple[int, int]:
            count, at, pos = start(data, at, parts, pos)
            if not count:
                return at, pos
            if to_cdr:
                parts.append(PADDING[-pos & mask])
                pos += -pos & mask
            else:
                at += -at & mask
            end = at + count * width
            if end > len(data):
                raise FieldError("the data ends within it")
            parts.append(data[at:end])
            return end, pos + count * width

        return numbers


def _smallest(message: Message) -> int:
    """Return the minimum size of a message in ROS 1."""
    size = 0
    for each in _flat(message):
        if not each.ros1:
            continue
        if isinstance(each, _Scalar):
            size += struct.calcsize(each.code)
        elif each.member.type.shape is Shape.SEQUENCE or each.member.type.base == "string":
            size += 4 * (each.member.type.size if each.member.type.shape is Shape.ARRAY else 1)
        else:
            member = each.member
            one = _smallest(member.message) if member.message else struct.calcsize(CODES.get(member.type.base, "I"))
            size += one * (member.type.size if member.type.shape is Shape.ARRAY else 1)
    return size


def _length(data: memoryview, at: int, smallest: int) -> tuple[int, int]:
    """Read a length; raise FieldError if the rest of the data cannot hold so many elements of `smallest` bytes."""
    (count,) = _LENGTH.unpack_from(data, at)
    at += 4
    if count * smallest > len(data) - at:
        raise FieldError(f"the length {count} exceeds the remaining data")
    return count, at


def _put_length(count: int, parts: list[Buffer], pos: int, *, to_cdr: bool) -> int:
    padding = -pos & 3 if to_cdr else 0
    parts += (PADDING[padding], _LENGTH.pack(count))
    return pos + padding + 4


def _run(scalars: list[_Scalar], *, to_cdr: bool) -> Copy:
    """Copy adjacent scalars. What one form lacks is skipped in the other, or becomes zero."""
    packed = struct.Struct("<" + "".join(_code(each, present=each.ros2) for each in scalars if each.ros1))
    aligned = [_aligned([each for each in scalars if each.ros2], offset) for offset in range(8)]

    def into_cdr(data: memoryview, at: int, parts: list[Buffer], pos: int) -> tuple[int, int]:
        form = aligned[pos & 7]
        parts.append(form.pack(*packed.unpack_from(data, at)))
        return at + packed.size, pos + form.size

    def out_of_cdr(data: memoryview, at: int, parts: list[Buffer], pos: int) -> tuple[int, int]:
        form = aligned[at & 7]
        parts.append(packed.pack(*form.unpack_from(data, at)))
        return at + form.size, pos + packed.size

    return into_cdr if to_cdr else out_of_cdr


def _code(scalar: _Scalar, *, present: bool) -> str:
    return scalar.code if present else f"{struct.calcsize(scalar.code)}x"


def _aligned(scalars: list[_Scalar], offset: int) -> struct.Struct:
    form, at = "<", offset
    for each in scalars:
        size = struct.calcsize(each.code)
        padding = -at % size
        form += f"{padding}x{_code(each, present=each.ros1)}"
        at += padding + size
    return struct.Struct(form)


def _lacking(copy: Copy, *, to_cdr: bool) -> Copy:
    """Copy a field that ROS 1 lacks: from zeros to CDR, from CDR to nowhere."""

    def fill(data: memoryview, at: int, parts: list[Buffer], pos: int) -> tuple[int, int]:
        return at, copy(ZEROS, 0, parts, pos)[1]

    def skip(data: memoryview, at: int, parts: list[Buffer], pos: int) -> tuple[int, int]:
        return copy(data, at, [], 0)[0], pos

    return fill if to_cdr else skip


def _text_to_cdr(data: memoryview, at: int, parts: list[Buffer], pos: int) -> tuple[int, int]:
    size, at = _length(data, at, 1)
    text = _checked(data[at : at + size])
    pos = _put_length(size + 1, parts, pos, to_cdr=True)
    parts += (text, b"\0")
    return at + size, pos + size + 1


def _text_from_cdr(data: memoryview, at: int, parts: list[Buffer], pos: int) -> tuple[int, int]:
    size, at = _length(data, at + (-at & 3), 1)
    text = data[at : at + size]
    if size and text[-1] == 0:
        text = text[:-1]
    parts += (_LENGTH.pack(len(text)), text)
    return at + size, pos + 4 + len(text)


def _checked(text: memoryview) -> memoryview:
    """Return a string that nodes of ROS 2 can read: others end at one that is not UTF-8."""
    try:
        if "\0" in str(text, "utf-8"):
            raise FieldError("a ROS string cannot hold the character U+0000")
    except UnicodeDecodeError as error:
        raise FieldError(f"the string is not utf-8: {error.reason}") from None
    return text
