"""Message definitions: the fields of a ROS 2 type, read from the text of a `.msg` or `.srv` file.

The grammar is that of rosbags' parser, which lacks wide strings; they are added here. Its type store drops default
values, so the two of the common packages that are not zero stand in `DEFAULTS`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, TypeAlias

from rosbags.interfaces import Nodetype
from rosbags.typesys.base import BASE_NAMES, BaseType, Cardinality, NamedType, Type, TypesysError
from rosbags.typesys.msg import MSGParser
from rosbags.typesys.peg import Failure, Success

from rce.errors import InvalidRequest

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Fielddefs, FieldDesc
    from rosbags.typesys.peg import Result

Scalar: TypeAlias = bool | int | float | str
Default: TypeAlias = Scalar | list[Scalar] | None

# ROS primitive -> struct format character; sizes and alignments in CDR are those of the format.
CODES = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H",
    "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
STRINGS = frozenset({"string", "wstring"})
BYTES = frozenset({"uint8", "byte", "char"})

DEFAULTS: dict[tuple[str, str], Scalar] = {
    ("geometry_msgs/msg/Quaternion", "w"): 1.0,
    ("sensor_msgs/msg/NavSatStatus", "status"): -2,
}
DUMMY = "structure_needs_at_least_one_member"  # rosidl's filler of empty structures; not a field for anybody


class Shape(Enum):
    SINGLE = "single"
    ARRAY = "array"
    SEQUENCE = "sequence"


@dataclass(frozen=True, slots=True)
class FieldType:
    """`base` is a primitive, `string`, `wstring` or `pkg/msg/Name`; `size` the length of an array or the bound of a
    sequence, `text_bound` the bound of a string in bytes (0: none)."""

    base: str
    shape: Shape = Shape.SINGLE
    size: int = 0
    text_bound: int = 0

    @property
    def nested(self) -> bool:
        return "/" in self.base

    @property
    def is_bytes(self) -> bool:
        """Travels as base64 or as a blob."""
        return self.base in BYTES and self.shape is not Shape.SINGLE


@dataclass(frozen=True, slots=True)
class Field:
    name: str
    type: FieldType
    default: Default = None


Definition: TypeAlias = tuple[Field, ...]


class _Parser(MSGParser):
    """rosbags' parser and `wstring`."""

    def base_type(self, pos: int) -> Result[Type]:
        if isinstance(res := self.regex(pos, r"wstring\b"), Failure):
            return super().base_type(pos)
        return Success(res.pos, Type(BaseType(BASE_NAMES["wstring"])))

    def bounded_string(self, pos: int) -> Result[Type]:
        if isinstance(res := self.regex(pos, r"w?string<=[0-9]+"), Failure):
            return res
        base, _, bound = res.value.partition("<=")
        return Success(res.pos, Type(BaseType(BASE_NAMES[base]), Cardinality.SCALAR, int(bound)))


_SHAPES = {Cardinality.SCALAR: Shape.SINGLE, Cardinality.ARRAY: Shape.ARRAY, Cardinality.SEQUENCE: Shape.SEQUENCE}


def parse_message(name: str, text: str) -> Definition:
    """The fields of the `.msg` text of `pkg/msg/Name`; InvalidRequest if it is not one."""
    package, _, plain = name.partition("/msg/")
    try:
        messages = _Parser(f"MSG: {package}/msg/{plain}\n{text.replace(chr(13), '')}").specification()
    except (TypesysError, AssertionError, ValueError) as error:
        raise InvalidRequest(f"the definition of {name} is not a message definition: {_reason(error)}") from error
    fields = tuple(Field(f.name, _field_type(f.typ), f.value) for f in messages[0].fields)
    if len({field.name for field in fields}) < len(fields):
        raise InvalidRequest(f"the definition of {name} has two fields of one name")
    return fields


def parse_service(name: str, text: str) -> tuple[Definition, Definition]:
    """Request and response of the `.srv` text of `pkg/srv/Name`; InvalidRequest if it is not one."""
    parts = re.split(r"^---[ \t\r]*$", text, flags=re.MULTILINE)
    if len(parts) != 2:
        raise InvalidRequest(f"the definition of {name} is not a service definition: it needs exactly one line ---")
    message = name.replace("/srv/", "/msg/")  # a type without a package means a message of the same package
    return parse_message(message + "_Request", parts[0]), parse_message(message + "_Response", parts[1])


def from_rosbags(name: str, fields: Fielddefs) -> Definition:
    """The fields of a type of rosbags' type store."""
    return tuple(
        Field(field, _from_desc(desc), DEFAULTS.get((name, field))) for field, desc in fields if field != DUMMY
    )


def _reason(error: Exception) -> str:
    """The parser's complaint names the text, the position and the rest; the rest says where it stopped."""
    rest = str(error).rstrip("'").splitlines()
    return f"cannot read {rest[-1][:80]!r}" if rest else type(error).__name__


def _field_type(typ: Type) -> FieldType:
    base = typ.ref.name if isinstance(typ.ref, NamedType) else typ.ref.name.value
    return FieldType(base, _SHAPES[typ.cardinality], typ.size, typ.str_size)


def _from_desc(desc: FieldDesc) -> FieldType:
    if desc[0] == Nodetype.ARRAY or desc[0] == Nodetype.SEQUENCE:
        inner, size = desc[1]
        base = _from_desc(inner)
        shape = Shape.ARRAY if desc[0] == Nodetype.ARRAY else Shape.SEQUENCE
        return FieldType(base.base, shape, size, base.text_bound)
    if desc[0] == Nodetype.NAME:
        return FieldType(desc[1])
    return FieldType(desc[1][0], text_bound=desc[1][1])
