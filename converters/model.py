"""Models of ROS types: one msgspec struct per type, into which JSON is decoded.

Attributes are named f0, f1, … so that no field name can clash with Python; msgspec renames them to the ROS names, and
checks types and lengths and fills in defaults while it parses. A field that may be a blob has a second attribute for
the id of the blob (f2b, with the key `data*`).
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal, TypeAlias

import msgspec
from msgspec import UNSET, Meta, UnsetType

from converters.definition import CODES, STRINGS, Default, Definition, Field, FieldType, Shape
from converters.scalars import NON_FINITE, PACK_ERRORS, FieldError, packable
from rce.errors import InvalidRequest

TIME = "builtin_interfaces/msg/Time"
DURATION = "builtin_interfaces/msg/Duration"
HEADER = "std_msgs/msg/Header"
IMAGE = "sensor_msgs/msg/Image"

# An empty JSON object takes the memory of its type's defaults. No type of ROS comes near these limits.
MAX_SMALLEST = 1 << 20
MAX_DEPTH = 24
MAX_INLINED = 64  # fields; limits the number of steps of wide nested types

Number: TypeAlias = float | Literal["NaN", "Infinity", "-Infinity", "\0NaN", "\0Infinity", "\0-Infinity"]
Integer: TypeAlias = int | float  # 1.0 is accepted for 1; other fractions are rejected when the field is packed
Lookup: TypeAlias = Callable[[str], Definition]


@dataclass(frozen=True, eq=False, slots=True)
class Member:
    """Field of a message with its attribute name and, for a nested type, its message.

    An unwanted field is part of the layout, but readers skip it (`selection`).
    """

    field: Field
    attr: str
    message: Message | None
    wanted: bool = True

    @property
    def type(self) -> FieldType:
        """Type of the field."""
        return self.field.type

    @property
    def accepts_blob(self) -> bool:
        """True for byte arrays and images, which may be sent as blobs."""
        return self.type.is_bytes or self.type.base == IMAGE

    @property
    def inlined(self) -> Message | None:
        """Nested message whose fields are laid out and converted with those of the enclosing message, or None."""
        if self.message is None or self.type.shape is not Shape.SINGLE or self.type.base == IMAGE:
            return None
        return self.message if self.message.width <= MAX_INLINED else None


@dataclass(frozen=True, eq=False, slots=True)
class Message:
    """Message type that is ready for conversion.

    Attributes:
        name: Name of the type, `pkg/msg/Name`.
        members: Its fields.
        model: Struct into which its JSON is decoded.
        default: Message with all defaults, for the JSON `{}`.
        smallest: Minimum size in CDR.
        width: Number of its fields including those of inlined messages.
        has_stamp: Its default holds the time at which it is made, so that it is made anew for each message.
    """

    name: str
    members: tuple[Member, ...]
    model: type[msgspec.Struct]
    default: msgspec.Struct
    smallest: int
    width: int
    has_stamp: bool = False

    @property
    def annotation(self) -> object:
        """Type to decode JSON into; times and durations have a short form as well."""
        if self.name == TIME:
            return self.model | str
        return self.model | float if self.name == DURATION else self.model


class Models:
    """Cache of the message types of one set of definitions, built on first use.

    With `stamped` the stamp of a header is by default the time at which the message is decoded.
    """

    def __init__(self, lookup: Lookup, *, stamped: bool = False) -> None:
        self._lookup = lookup
        self._stamped = stamped
        self._known: dict[str, Message] = {}
        self._open: list[str] = []

    def message(self, name: str) -> Message:
        """Return a message type by its name.

        Raises:
            UnknownType: It or a type that it contains is not defined.
            InvalidRequest: It contains itself, is nested too deeply or is too large.
        """
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
            raise InvalidRequest(
                f"the type {name} is too large: even empty it has {smallest} bytes, and the limit is {MAX_SMALLEST}"
            )
        model = _model(name, members, stamped=self._stamped and name == HEADER)
        width = sum(member.inlined.width if member.inlined else 1 for member in members)
        has_stamp = self._stamped and (name == HEADER or any(_stamp_inside(member) for member in members))
        return Message(name, members, model, model(), smallest, max(width, 1), has_stamp)


def _stamp_inside(member: Member) -> bool:
    return member.type.shape is Shape.SINGLE and member.message is not None and member.message.has_stamp


def _smallest(member: Member) -> int:
    kind = member.type
    if kind.shape is Shape.SEQUENCE:
        return 4
    text_or_number = 4 if kind.base in STRINGS else struct.calcsize(CODES.get(kind.base, ""))
    one = member.message.smallest if member.message else text_or_number
    return one * (kind.size if kind.shape is Shape.ARRAY else 1)


def _model(name: str, members: tuple[Member, ...], *, stamped: bool) -> type[msgspec.Struct]:
    try:
        fields: list[tuple[str, object, object]] = [(m.attr, _annotation(m), _default(m, stamped)) for m in members]
    except FieldError as error:
        raise InvalidRequest(f"{name}.{error.path} has a default that it cannot hold: {error.reason}") from error
    for m in members:
        if m.accepts_blob:
            many = m.type.shape is not Shape.SINGLE and not m.type.is_bytes
            blob = msgspec.field(default=UNSET, name=m.field.name + "*")
            fields.append((m.attr + "b", (list[str] if many else str) | UnsetType, blob))
    keys = {m.attr: m.field.name for m in members}
    return msgspec.defstruct(
        name.rpartition("/")[2], fields, rename=keys, frozen=True, gc=False, forbid_unknown_fields=True
    )


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
    if kind.is_bytes:  # the length is checked when the field is packed: that of the base64 text is different
        return bytes | list[one]  # type: ignore[valid-type]
    low, high = (kind.size if kind.shape is Shape.ARRAY else None), (kind.size or None)
    return Annotated[list[one], Meta(min_length=low, max_length=high)]  # type: ignore[valid-type]


def _default(member: Member, stamped: bool) -> object:
    """Return the default value of a field, which is immutable because all messages share it, or the way to make it."""
    kind, given = member.type, member.field.default
    if member.message and stamped and kind.base == TIME:
        return msgspec.field(default_factory=_now(member.message.model))
    if member.message and _stamp_inside(member):
        return msgspec.field(default_factory=member.message.model)
    if kind.shape is Shape.SINGLE:
        return member.message.default if member.message and given is None else _scalar(member, given)
    if given is None:
        count = kind.size if kind.shape is Shape.ARRAY else 0
        return (
            bytes(count)
            if kind.is_bytes
            else (member.message.default if member.message else _scalar(member, None),) * count
        )
    values = tuple(_scalar(member, item) for item in (given if isinstance(given, list) else [given]))
    if kind.size and (len(values) > kind.size or (kind.shape is Shape.ARRAY and len(values) < kind.size)):
        raise FieldError(f"{len(values)} elements", member.field.name)
    return bytes(int(v) for v in values) if kind.is_bytes else values


def _now(model: type[msgspec.Struct]) -> Callable[[], msgspec.Struct]:
    """Return a function that returns the present time."""
    return lambda: model(*divmod(time.time_ns(), 1_000_000_000))


def _scalar(member: Member, given: Default) -> bool | int | float | str:
    base = member.type.base
    if isinstance(given, list) or (given is not None and member.message):
        raise FieldError("a single number or string is expected", member.field.name)
    if base in STRINGS:
        return "" if given is None else str(given)
    code = CODES[base]
    if code == "?":
        return bool(given)
    if isinstance(given, str) and given not in NON_FINITE:
        raise FieldError(f"{given[:60]!r} is not a number", member.field.name)
    try:
        return packable(given or 0, code)
    except (FieldError, *PACK_ERRORS) as error:
        raise FieldError(str(error), member.field.name) from error
