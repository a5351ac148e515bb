"""Messages as CBOR, with typed arrays (RFC 8746)."""

from __future__ import annotations

import math
import struct
from typing import Any

import cbor2

from converters import TypeRegistry, Wire
from rce.protocol.names import parse_type


def as_cbor(type_name: str, text: bytes) -> Any:
    codec = TypeRegistry().message(parse_type(type_name), dialect="cbor")
    wire = codec.decode(codec.encode(Wire(False, text, {})))
    assert wire.is_blob
    (blob,) = wire.blobs.values()
    return cbor2.loads(blob)


def test_numbers_are_little_endian_typed_arrays() -> None:
    scan = as_cbor("sensor_msgs/LaserScan", b'{"ranges": [1, 2.5], "angle_min": "NaN"}')
    assert scan["ranges"] == cbor2.CBORTag(85, struct.pack("<2f", 1, 2.5))
    assert math.isnan(scan["angle_min"])
    assert as_cbor("std_msgs/Int16MultiArray", b'{"data": [-1]}')["data"] == cbor2.CBORTag(77, b"\xff\xff")


def test_bytes_are_a_byte_string_and_structs_maps() -> None:
    image = as_cbor("sensor_msgs/Image", b'{"data": "AAEC", "header": {"frame_id": "eye"}}')
    assert image["data"] == b"\0\1\2"
    assert image["header"]["frame_id"] == "eye"
