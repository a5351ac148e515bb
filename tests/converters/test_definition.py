"""Definitions of messages and services, parsed from text or taken from rosbags."""

from __future__ import annotations

import pytest
from rosbags.typesys import Stores, get_typestore

from converters.definition import Default, Field, FieldType, Shape, from_rosbags, parse_message, parse_service
from rce.errors import InvalidRequest


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("int32 a", FieldType("int32")),
        ("uint8[4] a", FieldType("uint8", Shape.ARRAY, 4)),
        ("float64[] a", FieldType("float64", Shape.SEQUENCE)),
        ("float64[<=3] a", FieldType("float64", Shape.SEQUENCE, 3)),
        ("string<=5 a", FieldType("string", text_bound=5)),
        ("string<=2[<=3] a", FieldType("string", Shape.SEQUENCE, 3, 2)),
        ("wstring a", FieldType("wstring")),
        ("wstring<=4[] a", FieldType("wstring", Shape.SEQUENCE, text_bound=4)),
        ("float64 wstringy", FieldType("float64")),
        ("Inner a", FieldType("demo/msg/Inner")),
        ("other/Thing[2] a", FieldType("other/msg/Thing", Shape.ARRAY, 2)),
        ("Header a", FieldType("std_msgs/msg/Header")),
        ("time a", FieldType("builtin_interfaces/msg/Time")),
    ],
)
def test_type_of_field(text: str, expected: FieldType) -> None:
    (field,) = parse_message("demo/msg/A", text)
    assert field.type == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("int8 a", None),
        ("int8 a -1", -1),
        ("float32 a 0.5  # half", 0.5),
        ("bool a true", True),
        ('string a "x # y"', "x # y"),
        ('wstring a "Grüße"', "Grüße"),
        ("int16[] a [1, -2]", [1, -2]),
    ],
)
def test_default_of_field(text: str, expected: Default) -> None:
    (field,) = parse_message("demo/msg/A", text)
    assert field.default == expected


def test_comments_and_constants_are_no_fields() -> None:
    text = '# A comment.\r\nuint8 RED=1  # red\r\nstring NAME = "a # b"\r\n\r\nint8 a\r\n'
    assert parse_message("demo/msg/A", text) == (Field("a", FieldType("int8")),)
    assert parse_message("demo/msg/A", "# only a comment\n") == ()


@pytest.mark.parametrize("text", ["int8", "int8 a\nint16 a", "int8[ a", "x" * 100_000])
def test_malformed_message_is_rejected(text: str) -> None:
    with pytest.raises(InvalidRequest, match="demo/msg/X") as caught:
        parse_message("demo/msg/X", text)
    assert len(str(caught.value)) < 300


def test_parts_of_service() -> None:
    request, response = parse_service("demo/srv/Add", "int64 a\r\nInner inner\r\n--- \r\nint64 sum\r\n")
    assert request == (Field("a", FieldType("int64")), Field("inner", FieldType("demo/msg/Inner")))
    assert response == (Field("sum", FieldType("int64")),)
    assert parse_service("demo/srv/Nothing", "---") == ((), ())


@pytest.mark.parametrize("text", ["", "int8 a", "int8 a\n---\n---\n", "int8 a\n----\n"])
def test_service_needs_one_separator(text: str) -> None:
    with pytest.raises(InvalidRequest, match="exactly one line ---"):
        parse_service("demo/srv/X", text)


def test_error_names_the_part_of_the_service() -> None:
    with pytest.raises(InvalidRequest, match="demo/srv/X_Response"):
        parse_service("demo/srv/X", "int8 a\n---\nint8")


def test_fields_of_rosbags() -> None:
    known = get_typestore(Stores.ROS2_KILTED).fielddefs
    quaternion = from_rosbags("geometry_msgs/msg/Quaternion", known["geometry_msgs/msg/Quaternion"][1])
    assert [(field.name, field.default) for field in quaternion] == [("x", None), ("y", None), ("z", None), ("w", 1.0)]
    (uuid,) = from_rosbags("unique_identifier_msgs/msg/UUID", known["unique_identifier_msgs/msg/UUID"][1])
    assert uuid.type == FieldType("uint8", Shape.ARRAY, 16)
    scan = from_rosbags("sensor_msgs/msg/LaserScan", known["sensor_msgs/msg/LaserScan"][1])
    assert scan[0].type == FieldType("std_msgs/msg/Header")
    assert scan[-1].type == FieldType("float32", Shape.SEQUENCE)


def test_filler_of_empty_structs_is_no_field() -> None:
    known = get_typestore(Stores.ROS2_KILTED).fielddefs
    assert from_rosbags("std_msgs/msg/Empty", known["std_msgs/msg/Empty"][1]) == ()


def test_only_arrays_and_sequences_of_bytes_are_bytes() -> None:
    assert FieldType("char", Shape.SEQUENCE).is_bytes
    assert not FieldType("uint8").is_bytes
    assert not FieldType("int8", Shape.SEQUENCE).is_bytes
