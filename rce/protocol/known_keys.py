"""Refusal of keys that a value does not have: a misspelt option is not an option that was left out."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import TypeVar

import msgspec
from msgspec import Raw, inspect

from rce.errors import InvalidRequest
from rce.spelling import did_you_mean

Parts = TypeVar("Parts", dict[str, Raw], list[Raw])


def check_keys(kind: type, raw: Raw | bytes, where: str) -> None:
    """Check that the objects of a JSON value have no keys but those of their types.

    What is malformed otherwise is left to the decoder.

    Args:
        kind: Type of the value.
        raw: The value.
        where: Place of the value, for the error.

    Raises:
        InvalidRequest: There is such a key; the error has its path and the nearest one that there is.
    """
    for field, key, known in unknown_keys(kind, raw):
        hint = did_you_mean(key, known) or f"there are {', '.join(known) or 'none'}"
        raise InvalidRequest(f"{where}.{field}: there is no such key: {hint}", field=field)


def unknown_keys(kind: type, raw: Raw | bytes) -> Iterator[tuple[str, str, list[str]]]:
    """Yield the keys of objects in a JSON value of a type that these do not have.

    Only objects whose keys are known are decoded; a value in them may be large.

    Args:
        kind: The type.
        raw: The value.

    Yields:
        The path of the key, the key, and the keys that its object may have.
    """
    for path, key, known in _unknown(_type_of(kind), raw, ""):
        yield f"{path}.{key[:80]}".lstrip("."), key, known


@lru_cache(None)
def _type_of(kind: type) -> inspect.Type:
    return inspect.type_info(kind)


def _unknown(kind: inspect.Type, raw: Raw | bytes, path: str) -> Iterator[tuple[str, str, list[str]]]:
    """Yield the unknown keys, each with the path of its object and the keys that this may have."""
    kind = _object_of(kind)
    if isinstance(kind, inspect.StructType):
        fields = {field.encode_name: field.type for field in kind.fields}
        for key, item in _parts(raw, dict[str, Raw]).items():
            if key in fields:
                yield from _unknown(fields[key], item, f"{path}.{key}")
            elif key != kind.tag_field:
                yield path, key, list(fields)
    elif isinstance(kind, inspect.ListType) and _has_objects(kind.item_type):
        for index, item in enumerate(_parts(raw, list[Raw])):
            yield from _unknown(kind.item_type, item, f"{path}[{index}]")


def _parts(raw: Raw | bytes, kind: type[Parts]) -> Parts:
    """Return the parts of an object or a list; empty if the value is something else or malformed."""
    try:
        return msgspec.json.decode(raw, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return kind()


def _object_of(kind: inspect.Type) -> inspect.Type:
    """Return the type of the object in a union of one object with other types; any other type as it is."""
    structs = (
        [each for each in kind.types if isinstance(each, inspect.StructType)]
        if isinstance(kind, inspect.UnionType)
        else []
    )
    return structs[0] if len(structs) == 1 else kind


def _has_objects(kind: inspect.Type) -> bool:
    """Return True if there are objects in values of a type whose keys are known."""
    kind = _object_of(kind)
    return isinstance(kind, inspect.StructType) or (isinstance(kind, inspect.ListType) and _has_objects(kind.item_type))
