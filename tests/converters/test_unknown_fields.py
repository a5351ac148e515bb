"""Fields that a type does not have: refused with the nearest one, but ignored as the original did for its clients."""

from __future__ import annotations

import json
from typing import Any

import pytest

from converters import TypeRegistry
from converters.scalars import FieldError
from converters.unknown_fields import explained
from rce.errors import ConversionError
from rce.protocol.names import parse_type
from tests.support.converters.conversions import demo_models, encoding_error, json_wire

REGISTRY = TypeRegistry()


@pytest.mark.parametrize(
    ("type_name", "message", "field", "reason"),
    [
        ("std_msgs/String", {"dat": "hi"}, "dat", "std_msgs/msg/String has no such field: did you mean data?"),
        ("geometry_msgs/Twist", {"linear": {"X": 1}}, "linear.X", "geometry_msgs/msg/Vector3 .*: it has x, y, z"),
        ("tf2_msgs/TFMessage", {"transforms": [{}, {"heder": {}}]}, "transforms[1].heder", "did you mean header?"),
        ("std_msgs/Empty", {"data": 1}, "data", "it has none"),
        ("sensor_msgs/CompressedImage", {"dta*": "00"}, "dta*", "did you mean data?"),
    ],
)
def test_unknown_field_is_refused_with_the_nearest_one(type_name: str, message: Any, field: str, reason: str) -> None:
    with pytest.raises(ConversionError, match=reason) as caught:
        REGISTRY.message(parse_type(type_name), "json").encode(json_wire(json.dumps(message)))
    assert caught.value.info.field == field


def test_robots_of_the_original_send_what_they_like() -> None:
    plain = REGISTRY.message(parse_type("geometry_msgs/Twist"), "json")
    original = REGISTRY.message(parse_type("geometry_msgs/Twist"), "json", dialect="original")
    cdr = original.encode(json_wire('{"linear": {"x": 1, "w": 2}, "more": [1]}'))
    assert json.loads(bytes(plain.decode(cdr).raw))["linear"] == {"x": 1, "y": 0, "z": 0}


def test_long_name_is_cut_in_the_error() -> None:
    assert "no such field" in str(encoding_error(REGISTRY.message(parse_type("std_msgs/String")), {"x" * 1000: 1}))


def test_other_errors_are_unchanged() -> None:
    error = FieldError("too large", "x")
    assert explained(error, demo_models(A="int8 x").message("demo/msg/A")) is error
