"""Codecs with users' converters."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from converters import Converter, TypeRegistry, Wire
from converters.custom import CustomCodec
from rce.errors import ConversionError, InvalidRequest
from rce.protocol.names import parse_type
from tests.support.converters.conversions import json_wire

ID = "0a" * 16


class Packed(Converter):
    """A scan as its ranges in millimetres, two bytes each."""

    name = "packed"
    type = "sensor_msgs/LaserScan"

    def from_robot(self, value: Any) -> Mapping[str, object]:
        if not isinstance(value, bytes):
            raise ValueError("a packed scan is a blob")
        return {"range_max": 65.0, "ranges": np.frombuffer(value, "<u2") / 1000}

    def to_robot(self, message: dict[str, Any]) -> object:
        return (np.nan_to_num(np.array(message["ranges"]), posinf=65) * 1000).astype("<u2").tobytes()


class Loose(Converter):
    """Returns what a test says."""

    name = "loose"
    type = "sensor_msgs/CompressedImage"
    result: Any = None

    def from_robot(self, value: Any) -> Mapping[str, object]:
        return self.result(value)  # type: ignore[no-any-return]

    def to_robot(self, message: dict[str, Any]) -> object:
        return self.result(message)


def codec(converter: Converter) -> CustomCodec:
    return CustomCodec(TypeRegistry().message(parse_type(converter.type), "json"), converter)


def loose(result: Any) -> CustomCodec:
    converter = Loose()
    converter.result = result
    return codec(converter)


def blob(data: bytes) -> Wire:
    return Wire(True, f'"{ID}"'.encode(), {ID: data})


def test_blob_becomes_a_message_and_a_blob_again() -> None:
    made, plain = codec(Packed()), TypeRegistry().message(parse_type("sensor_msgs/LaserScan"))
    data = struct.pack("<3H", 1500, 250, 0)
    cdr = made.encode(blob(data))
    message = json.loads(bytes(plain.decode(cdr).raw))
    assert (message["range_max"], message["ranges"]) == (65, [1.5, 0.25, 0])
    wire = made.decode(cdr)
    assert wire.is_blob
    assert wire.blobs == {json.loads(bytes(wire.raw)): data}


def test_converter_gets_floats_as_they_are() -> None:
    plain = TypeRegistry().message(parse_type("sensor_msgs/LaserScan"))
    cdr = plain.encode(json_wire('{"ranges": ["Infinity", 1]}'))
    (data,) = codec(Packed()).decode(cdr).blobs.values()
    assert struct.unpack("<2H", data) == (65000, 1000)


def test_json_is_decoded_for_the_converter_and_its_result_is_json() -> None:
    made = loose(lambda value: {"format": value["f"], "data": b"xyz"} if "f" in value else value["format"])
    cdr = made.encode(json_wire('{"f": "png"}'))
    assert bytes(made.decode(cdr).raw) == b'"png"'


def test_fields_within_and_bytes_are_given_as_dicts_and_views() -> None:
    seen: list[dict[str, Any]] = []
    made = loose(
        lambda value: {"header": {"stamp": {"sec": 5}}, "data": bytearray(b"ab")} if value == 1 else seen.append(value)
    )
    made.decode(made.encode(json_wire("1")))
    assert seen[0]["header"] == {"stamp": {"sec": 5, "nanosec": 0}, "frame_id": ""}
    assert bytes(seen[0]["data"]) == b"ab"


@pytest.mark.parametrize(
    ("result", "reason"),
    [
        (lambda _: {"dat": b""}, "from_robot returned does not fit the type: Object contains unknown field `dat`"),
        (lambda _: {"format": 5}, "does not fit the type: Expected `str`, got `int`"),
        (lambda _: 7, "converter loose"),
        (lambda _: {"data": object()}, "a value is a object"),
        (lambda _: 1 / 0, r"test_custom.py, line \d+: ZeroDivisionError: division by zero"),
    ],
)
def test_failure_of_the_converter_costs_its_message_and_says_where(result: Any, reason: str) -> None:
    with pytest.raises(ConversionError, match=reason) as caught:
        loose(result).encode(json_wire("{}"))
    assert "sensor_msgs/msg/CompressedImage: converter loose: " in str(caught.value)
    assert len(str(caught.value)) < 400


def test_refusal_of_the_converter_reaches_the_robot_with_its_text() -> None:
    with pytest.raises(ConversionError, match=r"converter packed: a packed scan is a blob$"):
        codec(Packed()).encode(json_wire("{}"))


def test_failure_on_the_way_to_the_robot_is_told() -> None:
    cdr = loose(lambda _: {}).encode(json_wire("{}"))
    with pytest.raises(ConversionError, match="IndexError"):
        loose(lambda _: [][0]).decode(cdr)
    with pytest.raises(ConversionError, match="to_robot returned does not fit"):
        loose(lambda _: object()).decode(cdr)
    with pytest.raises(ConversionError, match="ends within"):
        loose(lambda _: 1).decode(b"\0\1\0\0")


def test_message_with_several_blobs_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="one blob"):
        codec(Packed()).encode(Wire(False, b'{"data*": "x"}', {ID: b""}))


def test_result_above_the_limit_is_refused() -> None:
    with pytest.raises(ConversionError, match="larger than"):
        loose(lambda _: {"data": bytes(1 << 26)}).encode(json_wire("{}"))
