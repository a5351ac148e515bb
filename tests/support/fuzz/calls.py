"""Examples of control calls, made from their types, and Banana, the encoding of Perspective Broker."""

from __future__ import annotations

import importlib
import pkgutil
import struct
from collections.abc import Mapping, Sequence
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec
from msgspec import Raw, Struct, UnsetType
from twisted.spread import banana

from rce.control import calls
from rce.control.calls.call import Call
from rce.control.pages import Question, encode_pages

MAX_NESTING = 3
TEXT = "testUser/fuzz"
NO_TYPES = (NoneType, UnsetType)


def examples() -> dict[str, dict[str, Any]]:
    """Return one valid call of each type, as msgpack has it, by its name."""
    for module in pkgutil.iter_modules(calls.__path__):
        importlib.import_module(f"{calls.__name__}.{module.name}")
    return {kind.__name__: example(kind) for kind in sorted(Call.__subclasses__(), key=lambda kind: kind.__name__)}


def example(kind: Any, nesting: int = 0) -> Any:
    """Return a value of a type, of plain lists, dicts, texts and numbers."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return example(arguments[0], nesting)
    if origin is Literal:
        return arguments[0]
    if origin in (Union, UnionType):
        return example(next(each for each in arguments if each not in NO_TYPES), nesting)
    if isinstance(kind, type) and issubclass(kind, Struct):
        return _example_struct(kind, nesting)
    if origin is not None and issubclass(origin, Mapping):
        return {} if nesting > MAX_NESTING else {TEXT: example(arguments[1], nesting + 1)}
    if origin is not None and issubclass(origin, Sequence):
        return [] if nesting > MAX_NESTING else [example(arguments[0], nesting + 1)]
    plain: dict[Any, Any] = {bool: True, int: 1, float: 1.5, bytes: b"x", dict: {}, list: []}
    return plain.get(kind, TEXT)


def _example_struct(kind: type[Struct], nesting: int) -> dict[str, Any]:
    if nesting > MAX_NESTING:
        return {}
    hints = get_type_hints(kind, include_extras=True)
    found = {field.encode_name: example(hints[field.name], nesting + 1) for field in msgspec.structs.fields(kind)}
    config = kind.__struct_config__
    return found | ({str(config.tag_field): config.tag} if config.tag_field else {})


def pages(name: str, value: Any) -> list[bytes]:
    """Return a mutated value as the pages of a call; what msgpack cannot express becomes text."""
    try:
        data = msgspec.msgpack.encode(value)
    except (OverflowError, UnicodeEncodeError, RecursionError, TypeError):
        data = repr(value).encode(errors="replace")[:10_000]
    return encode_pages(Question(name, "", 0, Raw(data)))


def encode(value: Any) -> bytes:
    """Return a message of numbers, bytes and lists in Banana."""
    if isinstance(value, list):
        return _digits(len(value)) + banana.LIST + b"".join(map(encode, value))
    if isinstance(value, bytes | str):
        text = value if isinstance(value, bytes) else value.encode(errors="replace")
        return _digits(len(text)) + banana.STRING + text
    if isinstance(value, float):
        return banana.FLOAT + struct.pack("!d", value)
    number = int(value) if isinstance(value, int) else 0
    small = -(2**31) < number < 2**31
    kinds = (banana.INT, banana.NEG) if small else (banana.LONGINT, banana.LONGNEG)
    return _digits(abs(number)) + kinds[number < 0]


def _digits(number: int) -> bytes:
    digits = bytearray()
    while number or not digits:
        digits.append(number & 127)
        number >>= 7
    return bytes(digits)
