"""Short forms of conversions for the tests of the converters."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, TypeAlias

import pytest

from converters import Codec, TypeRegistry, Wire
from converters.definition import parse_message
from converters.model import Models
from converters.types import common_definitions
from rce.errors import ConversionError
from rce.protocol.names import parse_type

CodecOf: TypeAlias = Callable[[str], Codec]


def registry_with(**definitions: str) -> TypeRegistry:
    """Return a registry with the messages of a package `demo`, given by the text of their definitions."""
    registry = TypeRegistry()
    registry.add({f"demo/msg/{name}": definition for name, definition in definitions.items()})
    return registry


def demo_codec(name: str, **definitions: str) -> Codec:
    """Return the codec of a message of the package `demo`, which has these definitions."""
    return registry_with(**definitions).message(parse_type(f"demo/{name}"))


def demo_models(**definitions: str) -> Models:
    """Return the models of the messages of the package `demo` and of the common packages."""
    own = {f"demo/msg/{name}": parse_message(f"demo/msg/{name}", text) for name, text in definitions.items()}
    return Models(lambda name: own[name] if name in own else common_definitions()[name])


def json_wire(raw: str | bytes) -> Wire:
    """Return a payload without blobs."""
    return Wire(False, raw if isinstance(raw, bytes) else raw.encode(), {})


def round_trip(codec: Codec, value: object) -> Any:
    """Encode a message as CDR, decode it again and return its JSON."""
    raw = value if isinstance(value, str) else json.dumps(value)
    return json.loads(bytes(codec.decode(codec.encode(json_wire(raw))).raw))


def encoding_error(codec: Codec, value: object) -> ConversionError:
    """Return the error with which a codec rejects a message."""
    with pytest.raises(ConversionError) as caught:
        codec.encode(json_wire(value if isinstance(value, str | bytes) else json.dumps(value)))
    assert codec.name in str(caught.value)
    assert len(str(caught.value)) < 400
    return caught.value
