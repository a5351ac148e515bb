"""Type definitions as text and as the records of rosapi."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from converters.definition import CODES, STRINGS, Definition, Field, Shape

SEPARATOR = "=" * 80


def message_text(definitions: Mapping[str, Definition], name: str) -> str:
    """Return a definition with those of the types in it, separated as in ROS 1 bags and MCAP (`ros2msg`).

    Args:
        definitions: Definitions by name, `pkg/msg/Name`.
        name: Name of the first.
    """
    texts = [_text(definitions[name])]
    for each in _inside(definitions, name):
        package, _, short = each.split("/")
        texts.append(f"{SEPARATOR}\nMSG: {package}/{short}\n{_text(definitions[each])}")
    return "".join(texts)


def _text(definition: Definition) -> str:
    return "".join(f"{_type(field)} {field.name}\n" for field in definition)


def _type(field: Field) -> str:
    kind = field.type
    base = kind.base
    if base not in CODES and base not in STRINGS:
        package, _, short = base.split("/")
        base = f"{package}/{short}"
    if kind.text_bound:
        base += f"<={kind.text_bound}"
    if kind.shape is Shape.ARRAY:
        return f"{base}[{kind.size}]"
    if kind.shape is Shape.SEQUENCE:
        return f"{base}[<={kind.size}]" if kind.size else f"{base}[]"
    return base


def _inside(definitions: Mapping[str, Definition], name: str) -> Iterator[str]:
    """Yield the names of the types that a type contains, each once."""
    seen, rest = {name}, [name]
    while rest:
        for field in definitions[rest.pop()]:
            if field.type.nested and field.type.base not in seen:
                seen.add(field.type.base)
                rest.append(field.type.base)
                yield field.type.base


def typedefs(definitions: Mapping[str, Definition], name: str) -> list[dict[str, Any]]:
    """Return a type, and those that it contains, as records `rosapi_msgs/TypeDef`."""
    return [_typedef(each, definitions[each]) for each in (name, *_inside(definitions, name))]


def _typedef(name: str, definition: Definition) -> dict[str, Any]:
    lengths = {Shape.SINGLE: -1, Shape.SEQUENCE: 0}
    return {
        "type": name.replace("/msg/", "/"),
        "fieldnames": [field.name for field in definition],
        "fieldtypes": [field.type.base.replace("/msg/", "/") for field in definition],
        "fieldarraylen": [lengths.get(field.type.shape, field.type.size) for field in definition],
        "examples": [_example(field) for field in definition],
        "constnames": [],
        "constvalues": [],
    }


def _example(field: Field) -> str:
    if field.type.shape is not Shape.SINGLE:
        return "[]"
    if field.type.base in STRINGS:
        return ""
    code = CODES.get(field.type.base)
    return "{}" if code is None else "False" if code == "?" else "0.0" if code in "fd" else "0"
