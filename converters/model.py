"""Messages as msgspec types: one structure per ROS type, into which the JSON is decoded.

Attributes are called f0, f1, … so that no field name can clash with Python; msgspec renames them to the ROS names and
checks types, lengths and defaults while it parses. Where a blob may stand for a field, a twin attribute (f2b, with the
key `data*`) takes its id.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal, TypeAlias

import msgspec
from msgspec import UNSET, Meta, UnsetType

from converters.definition import CODES, STRINGS, Default, Definition, Field, FieldType, Shape
from converters.fitting import NON_FINITE, PACK_ERRORS, Misfit, fit
from rce.errors import InvalidRequest

TIME = "builtin_interfaces/msg/Time"
DURATION = "builtin_interfaces/msg/Duration"
IMAGE = "sensor_msgs/msg/Image"

# An empty JSON object costs the size of its type's defaults. ROS has nothing near these limits.
MAX_SMALLEST = 1 << 20
MAX_DEPTH = 24
MAX_INLINED = 64  # fields; keeps the steps of wide nested types from multiplying

Number: TypeAlias = float | Literal["NaN", "Infinity", "-Infinity", "\0NaN", "\0Infinity", "\0-Infinity"]
Integer: TypeAlias = int | float  # 1.0 is accepted for 1; other fractions fail later, where the path is known
Lookup: TypeAlias = Callable[[str], Definition]


@dataclass(frozen=True, eq=False, slots=True)
class Member:
    field: Field
    attr: str
    message: Message | None  # of a nested type

    @property
    def type(self) -> FieldType:
        return self.field.type

    @property
    def takes_blob(self) -> bool:
        return self.type.is_bytes or self.type.base == IMAGE

    @property
    def inlined(self) -> Message | None:
        """The nested message whose fields are laid out and converted among those of its holder, if this is one."""
        if self.message is None or self.type.shape is not Shape.SINGLE or self.type.base == IMAGE:
            return None
        return self.message if self.message.width <= MAX_INLINED else None


@dataclass(frozen=True, eq=False, slots=True)
class Message:
    """A type ready for conversion. `default` is the message that `{}` means, `smallest` its least size in CDR, `width`
    the number of its fields with those of inlined messages."""

    name: str
    members: tuple[Member, ...]
    model: type[msgspec.Struct]
    default: msgspec.Struct
    smallest: int
    width: int

    @property
    def annotation(self) -> object:
        """The type to decode JSON into: times and durations have a second spelling."""
        if self.name == TIME:
            return self.model | str
        return self.model | float if self.name == DURATION else self.model


class Models:
    """Builds and keeps the messages of one set of definitions."""

    def __init__(self, lookup: Lookup) -> None:
        self._lookup = lookup
        self._known: dict[str, Message] = {}
        self._open: list[str] = []

    def message(self, name: str) -> Message:
        """UnknownType if it or a type in it is not defined, InvalidRequest if it contains itself or is enormous."""
        if name not in self._known:
            if name in self._open or len(self._open) >= MAX_DEPTH:
                raise InvalidRequest(f"{name} contains itself or is nested more than {MAX_DEPTH} deep")
            self._open.append(name)
            try:
                self._known[name] = self._build(name, self._lookup(name))
            finally:
                self._open.pop()
        return self._known[name]

    def _build(self, name: str, definition: Definition) -> Message:
        members = tuple(
            Member(field, f"f{i}", self.message(field.type.base) if field.type.nested else None)
            for i, field in enumerate(definition)
        )
        smallest = sum(_smallest(member) for member in members) or 1
        if smallest > MAX_SMALLEST:
            raise InvalidRequest(f"an empty {name} already has {smallest} bytes; {MAX_SMALLEST} is the limit")
        model = _model(name, members)
        width = sum(member.inlined.width if member.inlined else 1 for member in members)
        return Message(name, members, model, model(), smallest, max(width, 1))


def _smallest(member: Member) -> int:
    kind = member.type
    if kind.shape is Shape.SEQUENCE:
        return 4
    text_or_number = 4 if kind.base in STRINGS else struct.calcsize(CODES.get(kind.base, ""))
    one = member.message.smallest if member.message else text_or_number
    return one * (kind.size if kind.shape is Shape.ARRAY else 1)


def _model(name: str, members: tuple[Member, ...]) -> type[msgspec.Struct]:
    try:
        fields: list[tuple[str, object, object]] = [(m.attr, _annotation(m), _default(m)) for m in members]
    except Misfit as error:
        raise InvalidRequest(f"{name}.{error.path} has a default that it cannot hold: {error.reason}") from error
    for m in members:
        if m.takes_blob:
            many = m.type.shape is not Shape.SINGLE and not m.type.is_bytes
            blob = msgspec.field(default=UNSET, name=m.field.name + "*")
            fields.append((m.attr + "b", (list[str] if many else str) | UnsetType, blob))
    keys = {m.attr: m.field.name for m in members}
    return msgspec.defstruct(name.rpartition("/")[2], fields, rename=keys, frozen=True, gc=False)


def _annotation(member: Member) -> object:
    kind = member.type
    if member.message:
        one: object = member.message.annotation
    elif kind.base in STRINGS:
        one = str
    else:
        one = {"?": bool, "f": Number, "d": Number}.get(CODES[kind.base], Integer)
    if kind.shape is Shape.SINGLE:
        return one
    if kind.is_bytes:  # its length is checked when it is written: as base64 it is not that of the text
        return bytes | list[one]  # type: ignore[valid-type]
    low, high = (kind.size if kind.shape is Shape.ARRAY else None), (kind.size or None)
    return Annotated[list[one], Meta(min_length=low, max_length=high)]  # type: ignore[valid-type]


def _default(member: Member) -> object:
    """Immutable, as all messages share it."""
    kind, given = member.type, member.field.default
    if kind.shape is Shape.SINGLE:
        return member.message.default if member.message else _scalar(member, given)
    if given is None:
        count = kind.size if kind.shape is Shape.ARRAY else 0
        return (
            bytes(count)
            if kind.is_bytes
            else (member.message.default if member.message else _scalar(member, None),) * count
        )
    values = tuple(_scalar(member, item) for item in (given if isinstance(given, list) else [given]))
    if kind.size and (len(values) > kind.size or (kind.shape is Shape.ARRAY and len(values) < kind.size)):
        raise Misfit(f"{len(values)} elements", member.field.name)
    return bytes(int(v) for v in values) if kind.is_bytes else values


def _scalar(member: Member, given: Default) -> bool | int | float | str:
    base = member.type.base
    if isinstance(given, list) or (given is not None and member.message):
        raise Misfit("a single number or string is expected", member.field.name)
    if base in STRINGS:
        return "" if given is None else str(given)
    code = CODES[base]
    if code == "?":
        return bool(given)
    if isinstance(given, str) and given not in NON_FINITE:
        raise Misfit(f"{given[:60]!r} is not a number", member.field.name)
    try:
        return fit(given or 0, code)
    except (Misfit, *PACK_ERRORS) as error:
        raise Misfit(str(error), member.field.name) from error
