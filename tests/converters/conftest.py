from __future__ import annotations

import pytest
from conversions import CodecOf

from converters import TypeRegistry
from rce.names import parse_type


@pytest.fixture(scope="session")
def registry() -> TypeRegistry:
    """The common types; tests that teach types make their own."""
    return TypeRegistry()


@pytest.fixture
def codec(registry: TypeRegistry) -> CodecOf:
    """The codec of a common message type by its name, with images as JSON."""
    return lambda name: registry.message(parse_type(name), "json")
