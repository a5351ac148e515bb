"""Message definitions: the fields of a ROS 2 type, parsed from the text of a `.msg` or `.srv` file.

The grammar is that of rosbags' parser, extended by wide strings. The type store of rosbags has no default values; the
two defaults of the common packages that are not zero are in `DEFAULTS`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
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

# ROS primitive type -> struct format character. The format also has the size, which is the alignment in CDR.
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
DUMMY = "structure_needs_at_least_one_member"  # filler that rosidl adds to empty structs; not a field of the message


class Shape(Enum):
    """Multiplicity of a field."""

    SINGLE = "single"
    ARRAY = "array"
    SEQUENCE = "sequence"


@dataclass(frozen=True, slots=True)
class FieldType:
    """Type of a field.

    Attributes:
        base: Primitive type, `string`, `wstring` or `pkg/msg/Name`.
        shape: Single value, array or sequence.
        size: Length of an array, or bound of a sequence (0: unbounded).
        text_bound: Bound of a string, in bytes or UTF-16 units (0: unbounded).
    """

    base: str
    shape: Shape = Shape.SINGLE
    size: int = 0
    text_bound: int = 0

    @property
    def nested(self) -> bool:
        """True if the base type is a message."""
        return "/" in self.base

    @property
    def is_bytes(self) -> bool:
        """True for byte arrays and sequences, which are base64 or blobs on the wire."""
        return self.base in BYTES and self.shape is not Shape.SINGLE


@dataclass(frozen=True, slots=True)
class Field:
    """Field of a message definition."""

    name: str
    type: FieldType
    default: Default = None


Definition: TypeAlias = tuple[Field, ...]


class _Parser(MSGParser):
    """rosbags' parser, extended by `wstring`."""

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
    """Parse the text of a `.msg` file, or of one half of a `.srv` file.

    Args:
        name: Name of the type, `pkg/msg/Name` or `pkg/srv/Name`.
        text: Content of the file.

    Raises:
        InvalidRequest: The text is not a message definition.
    """
    package, _, plain = name.split("/")
    try:
        # Types without a package are messages of the same package, in services as well: hence msg in any case.
        messages = _Parser(f"MSG: {package}/msg/{plain}\n{text.replace(chr(13), '')}").specification()
    except (TypesysError, AssertionError, ValueError) as error:
        raise InvalidRequest(f"the definition of {name} is not a message definition: {_reason(error)}") from error
    fields = tuple(Field(f.name, _field_type(f.typ), f.value) for f in messages[0].fields)
    if len({field.name for field in fields}) < len(fields):
        raise InvalidRequest(f"the definition of {name} has two fields of the same name")
    return fields


def parse_service(name: str, text: str) -> tuple[Definition, Definition]:
    """Parse the text of a `.srv` file into the definitions of request and response.

    Args:
        name: Name of the type, `pkg/srv/Name`.
        text: Content of the file.

    Raises:
        InvalidRequest: The text is not a service definition.
    """
    request, response = _parts(name, text, ("_Request", "_Response"), "a service definition: it needs exactly one line")
    return request, response


def parse_action(name: str, text: str) -> tuple[Definition, Definition, Definition]:
    """Parse the text of a `.action` file into the definitions of goal, result and feedback.

    Args:
        name: Name of the type, `pkg/action/Name`.
        text: Content of the file.

    Raises:
        InvalidRequest: The text is not an action definition.
    """
    sections = ("_Goal", "_Result", "_Feedback")
    goal, result, feedback = _parts(name, text, sections, "an action definition: it needs exactly two lines")
    return goal, result, feedback


def _parts(name: str, text: str, sections: Sequence[str], what: str) -> list[Definition]:
    parts = re.split(r"^---[ \t\r]*$", text, flags=re.MULTILINE)
    if len(parts) != len(sections):
        raise InvalidRequest(f"the definition of {name} is not {what} ---")
    return [parse_message(name + section, part) for section, part in zip(sections, parts, strict=True)]


def from_rosbags(name: str, fields: Fielddefs) -> Definition:
    """Convert the fields of a type of rosbags' type store."""
    return tuple(
        Field(field, _from_desc(desc), DEFAULTS.get((name, field))) for field, desc in fields if field != DUMMY
    )


def _reason(error: Exception) -> str:
    """Return the place where the parser stopped, which is the last line of its message."""
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
