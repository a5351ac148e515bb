"""JSON Schemas in one form on all versions of Python."""

from __future__ import annotations

import json
from inspect import cleandoc
from typing import Any, cast


def normalized(document: dict[str, Any]) -> dict[str, Any]:
    """Return a schema as decoded JSON. Its descriptions have no indentation, which only Python before 3.13 keeps."""
    decoded = json.loads(json.dumps(document), object_hook=_without_indentation)  # defaults may be tuples
    return cast("dict[str, Any]", decoded)


def _without_indentation(value: dict[str, Any]) -> dict[str, Any]:
    description = value.get("description")
    return value | {"description": cleandoc(description)} if isinstance(description, str) else value
