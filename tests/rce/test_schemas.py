"""JSON Schemas in one form on all versions of Python."""

from __future__ import annotations

from typing import Any

from rce.schemas import normalized


def test_descriptions_have_no_indentation() -> None:
    written = "A thing.\n\n    Attributes:\n        size: Its size.\n    "
    part = {"description": written, "type": "object"}
    document = {"$defs": {"Thing": part}, "anyOf": [part]}
    (found,) = normalized(document)["anyOf"]
    assert found == {"description": "A thing.\n\nAttributes:\n    size: Its size.", "type": "object"}
    assert normalized(document)["$defs"]["Thing"] == found


def test_property_of_the_name_description_stays() -> None:
    properties: dict[str, Any] = {"properties": {"description": {"type": "string"}}}
    assert normalized(properties) == properties


def test_defaults_are_values_of_json() -> None:
    assert normalized({"default": (1, 2)}) == {"default": [1, 2]}
