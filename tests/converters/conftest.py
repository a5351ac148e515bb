from __future__ import annotations

import pytest

from converters import TypeRegistry
from rce.protocol.names import parse_type
from tests.support.converters.conversions import CodecOf


@pytest.fixture(scope="session")
def registry() -> TypeRegistry:
    """A registry of the common types; tests that add types make their own."""
    return TypeRegistry()


@pytest.fixture
def codec(registry: TypeRegistry) -> CodecOf:
    """A function that returns the codec of a common message type by its name, with images as JSON."""
    return lambda name: registry.message(parse_type(name), "json")
