"""Strings, byte arrays and arrays of numbers written as CDR."""

from __future__ import annotations

import json
import struct

import pytest

from converters import Wire
from rce.errors import ConversionError
from tests.support.converters.conversions import CodecOf, demo_codec, encoding_error, json_wire, round_trip


def test_byte_arrays_are_base64_or_lists(codec: CodecOf) -> None:
    cloud, uuid = codec("sensor_msgs/PointCloud2"), codec("unique_identifier_msgs/UUID")
    for data in ('"AAH/"', "[0, 1, 255]", "[0.0, 1, 255]"):
        assert round_trip(cloud, f'{{"data": {data}}}')["data"] == "AAH/"
    assert round_trip(uuid, {"uuid": list(range(16))}) == {"uuid": "AAECAwQFBgcICQoLDA0ODw=="}
    assert round_trip(codec("nav_msgs/OccupancyGrid"), {"data": [-1, 0, 100]})["data"] == [-1, 0, 100]


def test_byte_array_may_be_a_blob(codec: CodecOf) -> None:
    cloud, blob_id = codec("sensor_msgs/PointCloud2"), "0" * 32
    for blob in (b"\0\1\xff", bytearray(b"\0\1\xff"), memoryview(b"\0\1\xff")):
        cdr = cloud.encode(Wire(False, f'{{"data*":"{blob_id}"}}'.encode(), {blob_id: blob}))
        assert json.loads(bytes(cloud.decode(cdr).raw))["data"] == "AAH/"


def test_blob_for_fixed_array_must_have_its_length(codec: CodecOf) -> None:
    with pytest.raises(ConversionError) as caught:
        codec("unique_identifier_msgs/UUID").encode(Wire(False, b'{"uuid*":"x"}', {"x": b"123"}))
    assert caught.value.field == "uuid"


def test_wide_strings_have_the_format_of_fast_cdr() -> None:
    """The expected bytes come from Fast CDR 2.3.3: the number of UTF-16 units, the units, no terminator."""
    codec = demo_codec("W", W="uint8 a\nwstring w\nuint8 b\nwstring[] v\nuint8 c\n")
    cdr = codec.encode(json_wire('{"a": 1, "w": "ab€", "b": 7, "v": ["x", "", "yz"], "c": 9}'))
    assert cdr.hex(" ") == (
        "00 01 00 00 01 00 00 00 03 00 00 00 61 00 62 00 ac 20 07 00 03 00 00 00 01 00 00 00 78 00 00 00 00 00 00 00 "
        "02 00 00 00 79 00 7a 00 09"
    )


def test_strings_are_aligned_and_terminated() -> None:
    codec = demo_codec("A", A="uint8 a\nstring b\nstring[] c\n")
    cdr = codec.encode(json_wire('{"a": 1, "b": "é", "c": ["", "xyz"]}'))
    assert cdr[4:] == struct.pack("<B3xI3sxII1s3xI4s", 1, 3, "é".encode() + b"\0", 2, 1, b"\0", 4, b"xyz\0")


def test_numbers_are_aligned_after_the_length() -> None:
    codec = demo_codec("A", A="uint8 a\nfloat64[] b\nuint8 c\nint16[2] d\n")
    cdr = codec.encode(json_wire('{"a": 1, "b": [2, 0.5], "c": 3, "d": [4, -5]}'))
    assert cdr[4:] == struct.pack("<B3xI2dBx2h", 1, 2, 2, 0.5, 3, 4, -5)


def test_empty_sequence_has_no_padding_after_its_length() -> None:
    codec = demo_codec("A", A="float64[] a\nuint8 b\n")
    assert codec.encode(json_wire('{"b": 1}'))[4:] == b"\0\0\0\0\1"


def test_non_finite_and_whole_numbers_in_arrays_are_converted() -> None:
    codec = demo_codec("A", A="float32[] a\nint8[] b\n")
    assert round_trip(codec, '{"a": [NaN, 1, "-Infinity"], "b": [1.0, -2]}') == {
        "a": ["NaN", 1.0, "-Infinity"],
        "b": [1, -2],
    }


@pytest.mark.parametrize(
    ("text", "value", "field"),
    [
        ("string<=5 a", "Grüße", "a"),  # seven bytes
        ("wstring<=2 a", "abc", "a"),
        ("wstring<=1 a", "😀", "a"),  # two UTF-16 units
        ("string a", "a\0b", "a"),
        ("string<=2[<=2] a", ["ab", "abc"], "a[1]"),
        ("string[<=2] a", ["a", "b", "c"], "a"),
        ("uint8[4] a", "AAAA", "a"),  # three bytes
        ("uint8[<=2] a", "AAAA", "a"),
        ("uint8[] a", [0, 256], "a[1]"),
        ("int16[] a", [0, 1.5], "a[1]"),
        ("float32[] a", [0, 1e39], "a[1]"),
    ],
)
def test_value_that_does_not_fit_is_rejected(text: str, value: object, field: str) -> None:
    assert encoding_error(demo_codec("A", A=text), {"a": value}).field == field


@pytest.mark.parametrize(
    ("text", "value"), [("string<=7 a", "Grüße"), ("wstring<=2 a", "😀"), ("uint8[<=3] a", "AAAA")]
)
def test_value_of_exactly_the_bound_is_accepted(text: str, value: object) -> None:
    assert round_trip(demo_codec("A", A=text), {"a": value}) == {"a": value}


def test_missing_blob_is_reported_under_its_key() -> None:
    assert encoding_error(demo_codec("A", A="uint8[] a"), {"a*": "none"}).field == "a*"
    error = encoding_error(demo_codec("A", A="sensor_msgs/Image[] a"), {"a*": ["none"]})
    assert error.field == "a*"
