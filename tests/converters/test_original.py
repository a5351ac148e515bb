"""JSON as the original's server wrote and read it."""

from __future__ import annotations

import json
import math
from datetime import datetime
from typing import Any

import pytest

from converters import Codec, TypeRegistry, Wire
from rce.errors import ConversionError
from rce.protocol.names import parse_type
from tests.support.converters.conversions import json_wire, registry_with


def codec(name: str, **definitions: str) -> Codec:
    registry = registry_with(**definitions) if definitions else TypeRegistry()
    return registry.message(parse_type(name), dialect="original")


def there_and_back(kind: Codec, value: Any) -> Any:
    return json.loads(bytes(memoryview(kind.decode(kind.encode(json_wire(json.dumps(value)))).raw)))


def test_times_are_iso_8601_and_durations_are_numbers() -> None:
    header = codec("std_msgs/Header")
    stamp = datetime(2013, 11, 15, 10, 20, 30, 123456).isoformat()
    assert there_and_back(header, {"stamp": stamp})["stamp"] == "2013-11-15T10:20:30.123456"
    assert there_and_back(header, {})["stamp"] == "1970-01-01T00:00:00"
    action = codec("visualization_msgs/Marker")
    assert there_and_back(action, {"lifetime": -1.5})["lifetime"] == -1.5
    assert there_and_back(codec("builtin_interfaces/Time"), "2013-11-15T10:20:30") == "2013-11-15T10:20:30"
    assert there_and_back(codec("builtin_interfaces/Duration"), "2.5") == 2.5


def test_stamp_that_is_not_normal_is_written() -> None:
    cdr = codec("builtin_interfaces/Time").encode(json_wire('{"sec": -1, "nanosec": 4000000000}'))
    assert codec("builtin_interfaces/Time").decode(cdr).raw == b'"1970-01-01T00:00:03"'


def test_non_finite_numbers_are_bare_tokens() -> None:
    kind = codec("demo/A", A="float32 one\nfloat64[] many\nstring text\n")
    value = {"one": math.nan, "many": [1.0, math.inf, -math.inf], "text": '"NaN" \\u0000NaN'}
    raw = kind.decode(kind.encode(json_wire(json.dumps(value)))).raw
    assert raw == rb'{"one":NaN,"many":[1.0,Infinity,-Infinity],"text":"\"NaN\" \\u0000NaN"}'


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"i": "5"}, {"i": 5}),
        ({"i": 3.7}, {"i": 3}),
        ({"i": -3.7}, {"i": -3}),
        ({"i": True}, {"i": 1}),
        ({"f": "1.5"}, {"f": 1.5}),
        ({"f": False}, {"f": 0.0}),
        ({"b": 0}, {"b": False}),
        ({"b": 1}, {"b": True}),
        ({"b": "no"}, {"b": True}),
        ({"b": None}, {"b": False}),
        ({"many": ["1", 2.9, True]}, {"many": [1, 2, 1]}),
        ({"raw": ["1", 2.9]}, {"raw": "AQI="}),
        ({"inner": {"i": "7"}}, {"inner": {"i": 7}}),
        ({"inners": [{"i": "7"}, {}], "unknown": {"x": [1]}}, {"inners": [{"i": 7}, {"i": 0}]}),
    ],
)
def test_values_are_converted_as_the_original_did(given: dict[str, Any], expected: dict[str, Any]) -> None:
    text = "int32 i\nfloat32 f\nbool b\nint16[] many\nuint8[] raw\nInner inner\nInner[] inners\n"
    found = there_and_back(codec("demo/A", A=text, Inner="int8 i\n"), given)
    assert {name: found[name] for name in expected} == expected


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ('{"i": "five"}', "i"),
        ('{"i": null}', "i"),
        ('{"i": 1e300}', "i"),
        ('{"i": NaN}', "i"),
        ('{"i": "99999999999"}', "i"),
        ('{"text": 5}', "text"),
        ('{"i": "5", "text": ', ""),
        ('{"i": "' + "5" * 5000 + '"}', "i"),
    ],
)
def test_other_values_are_refused_with_the_field(given: str, field: str) -> None:
    kind = codec("demo/A", A="int32 i\nstring text\n")
    with pytest.raises(ConversionError) as raised:
        kind.encode(json_wire(given))
    assert raised.value.info.field == field


def test_deep_json_is_refused() -> None:
    with pytest.raises(ConversionError, match="nested too deeply"):
        codec("std_msgs/String").encode(Wire(False, b'{"data": 5, "x": ' + b"[" * 100_000 + b"}", {}))


def test_codec_of_recipe_is_the_same_kind() -> None:
    same = TypeRegistry.codec_of(codec("std_msgs/Header").recipe)
    assert there_and_back(same, {"stamp": "2013-11-15T10:20:30"})["stamp"] == "2013-11-15T10:20:30"
