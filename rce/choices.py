"""Errors of decoding that list the values among which there is a choice."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Any

from msgspec import inspect

_PLACE = " - at `$"
_PART = re.compile(r"\.(\w+)|\[(?:\d+|\.\.\.)\]")


def with_choices(error: Exception, kind: Any) -> tuple[str, str]:
    """Return what is wrong with a value of type `kind`, and the path of the place, as `nodes[0].restart`.

    Of a text that is none of several, the message names these: msgspec does not.
    """
    reason, _, place = str(error).partition(_PLACE)
    path = place.rstrip("`")
    if reason.startswith("Invalid enum value"):
        known = [repr(value) for value in _choices(_type_of(kind), path) if value != ""]
        reason += f": write {', '.join(known[:-1])} or {known[-1]}" if len(known) > 1 else ""
    return reason, path.lstrip(".")


@lru_cache(256)
def _type_of(kind: Any) -> inspect.Type:
    return inspect.type_info(kind)


def _choices(kind: inspect.Type, path: str) -> list[Any]:
    """Return the values of the literals at a path below a type."""
    kinds = [kind]
    for part in _PART.finditer(path):
        kinds = [below for each in kinds for below in _below(_bare(each), part[1])]
    literals = [each for kind in kinds for each in _alternatives(_bare(kind)) if isinstance(each, inspect.LiteralType)]
    return [value for each in literals for value in each.values]


def _below(kind: inspect.Type, name: str | None) -> list[inspect.Type]:
    found: list[inspect.Type] = []
    for each in _alternatives(kind):
        if name is None and isinstance(each, inspect.ListType):
            found.append(each.item_type)
        elif isinstance(each, inspect.DictType):
            found.append(each.value_type)
        elif isinstance(each, inspect.StructType | inspect.TypedDictType):
            found += [field.type for field in each.fields if name == field.encode_name]
    return found


def _alternatives(kind: inspect.Type) -> list[inspect.Type]:
    kind = _bare(kind)
    return [_bare(each) for each in kind.types] if isinstance(kind, inspect.UnionType) else [kind]


def _bare(kind: inspect.Type) -> inspect.Type:
    while isinstance(kind, inspect.Metadata):
        kind = kind.type
    return kind
