"""Layout of messages in CDR (XCDR version 1, OMG DDS-XTypes 1.3, section 7.4.1).

Each primitive is aligned to its size, counted from the end of the 4-byte encapsulation header; structs have no
alignment of their own. Adjacent scalars, also those of nested structs, form a `Run`: one `struct` format with its
padding. A run ends where the padding depends on the data before it. Everything else is an `Item`. An empty struct is
one byte, since rosidl adds a filler to it (C has no empty structs).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

from converters.definition import CODES, STRINGS, Shape
from converters.model import Member, Message
from converters.scalars import join


class Leaf(NamedTuple):
    """Scalar: the attributes that lead to it from the message, its path in ROS names, and its format character."""

    attrs: tuple[str, ...]
    path: str
    code: str
    wanted: bool = True


@dataclass(frozen=True, slots=True)
class Run:
    """Adjacent scalars. `mask` + 1 is the alignment of the first byte; 1 if the layout guarantees it."""

    mask: int
    struct: struct.Struct
    leaves: tuple[Leaf, ...]


@dataclass(frozen=True, slots=True)
class Item:
    """String, array, sequence, or struct that is not inlined."""

    attrs: tuple[str, ...]
    path: str
    member: Member


Step: TypeAlias = Run | Item


@dataclass(slots=True)
class _Layout:
    """Builder of the steps; the position in the buffer is known to be `offset` modulo `modulus`."""

    modulus: int
    offset: int = 0
    steps: list[Step] = field(default_factory=list)
    mask: int = 0
    format: str = ""
    leaves: list[Leaf] = field(default_factory=list)

    def add_scalar(self, leaf: Leaf) -> None:
        size = struct.calcsize(leaf.code)
        if size > self.modulus:
            self.close()
            self.mask, self.modulus, self.offset = size - 1, size, 0
        padding = -self.offset % size
        self.format += f"{padding}x{leaf.code}" if padding else leaf.code
        self.leaves.append(leaf)
        self.offset += padding + size

    def add_filler(self) -> None:
        self.format += "x"
        self.offset += 1

    def add_item(self, item: Item) -> None:
        self.close()
        self.steps.append(item)
        self.modulus, self.offset = 1, 0

    def close(self) -> None:
        if self.format:
            self.steps.append(Run(self.mask, struct.Struct("<" + self.format), tuple(self.leaves)))
        self.mask, self.format, self.leaves = 0, "", []


def layout(message: Message, *, top: bool) -> tuple[Step, ...]:
    """Return the steps of a message.

    Args:
        message: Type of the message.
        top: The message starts at the beginning of the buffer, so its alignment is known.
    """
    state = _Layout(8 if top else 1)
    for found in _leaves(message, (), ""):
        if isinstance(found, Leaf):
            state.add_scalar(found)
        elif isinstance(found, Item):
            state.add_item(found)
        else:
            state.add_filler()
    state.close()
    return tuple(state.steps)


def _leaves(message: Message, attrs: tuple[str, ...], path: str) -> Iterator[Leaf | Item | None]:
    """Yield the scalars and items of a message and its inlined messages in order; None for the filler."""
    if not message.members:
        yield None
    for member in message.members:
        here, name = (*attrs, member.attr), join(path, member.field.name)
        if nested := member.inlined:
            yield from _leaves(nested, here, name)
        elif member.type.shape is Shape.SINGLE and not member.type.nested and member.type.base not in STRINGS:
            yield Leaf(here, name, CODES[member.type.base], member.wanted)
        else:
            yield Item(here, name, member)
