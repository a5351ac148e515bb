"""Messages written as CDR: nesting, alignment, and the field that errors name."""

from __future__ import annotations

import struct

import pytest

from converters import writer
from tests.support.converters.conversions import CodecOf, demo_codec, encoding_error, json_wire


@pytest.mark.parametrize(
    ("name", "value", "field"),
    [
        ("nav_msgs/Path", {"poses": [{}, {}, {"pose": {"position": {"x": "far"}}}]}, "poses[2].pose.position.x"),
        ("nav_msgs/Path", {"poses": [{}, {"header": {"stamp": {"nanosec": -1}}}]}, "poses[1].header.stamp.nanosec"),
        ("sensor_msgs/LaserScan", {"ranges": [1, 2, 1e39]}, "ranges[2]"),
        ("sensor_msgs/LaserScan", {"ranges": [1, "x"]}, "ranges[1]"),
        ("nav_msgs/Odometry", {"pose": {"covariance": [0] * 35}}, "pose.covariance"),
        ("nav_msgs/Odometry", {"twist": {"covariance": [0] * 35 + ["far"]}}, "twist.covariance[35]"),
        ("diagnostic_msgs/DiagnosticArray", {"status": [{"values": [{"key": "\0"}]}]}, "status[0].values[0].key"),
        ("sensor_msgs/JointState", {"name": ["a", 7]}, "name[1]"),
        ("sensor_msgs/JointState", {"name": ["a", "\0"]}, "name[1]"),
        ("nav_msgs/OccupancyGrid", {"data": [0, 300]}, "data[1]"),
        ("sensor_msgs/PointCloud2", {"data": [0, 300]}, "data[1]"),
        ("sensor_msgs/PointCloud2", {"data": "no base64!"}, "data"),
        ("sensor_msgs/PointCloud2", {"data": "AAA"}, "data"),
        ("unique_identifier_msgs/UUID", {"uuid": "AAAA"}, "uuid"),
        ("unique_identifier_msgs/UUID", {"uuid": [1] * 17}, "uuid"),
        ("geometry_msgs/Twist", {"linear": None}, "linear"),
        ("geometry_msgs/Twist", {"linear": []}, "linear"),
        ("shape_msgs/SolidPrimitive", {"dimensions": [1, 2, 3, 4]}, "dimensions"),
        ("rcl_interfaces/ParameterDescriptor", {"integer_range": [{}, {}]}, "integer_range"),
    ],
)
def test_error_names_the_field(codec: CodecOf, name: str, value: object, field: str) -> None:
    assert encoding_error(codec(name), value).field == field


def test_nested_messages_are_aligned_from_the_beginning_of_the_data() -> None:
    codec = demo_codec("A", A="uint8 a\nInner[] many\nuint16 b\n", Inner="uint8 x\nfloat64 y\n")
    cdr = codec.encode(json_wire('{"a": 1, "many": [{"x": 2, "y": 0.5}, {"x": 3, "y": -1}], "b": 4}'))
    assert cdr[4:] == struct.pack("<B3xIB7xdB7xdH", 1, 2, 2, 0.5, 3, -1, 4)


def test_array_of_messages_has_no_length() -> None:
    codec = demo_codec("A", A="Inner[2] pair\n", Inner="uint16 x\n")
    assert codec.encode(json_wire('{"pair": [{"x": 1}, {"x": 2}]}'))[4:] == struct.pack("<HH", 1, 2)


def test_empty_struct_is_one_byte() -> None:
    codec = demo_codec("A", A="Nothing[2] pair\nuint8 end\n", Nothing="")
    assert codec.encode(json_wire('{"end": 5}'))[4:] == b"\0\0\5"


def test_times_and_durations_may_have_their_short_form_at_any_depth() -> None:
    codec = demo_codec("A", A="Inner inner\nbuiltin_interfaces/Time[] times\n", Inner="duration after\nfloat32 x\n")
    raw = '{"inner": {"after": 1.5, "x": 2}, "times": ["1970-01-01T00:00:01", {"sec": 2}]}'
    assert codec.encode(json_wire(raw))[4:] == struct.pack("<iIfI4i", 1, 500_000_000, 2.0, 2, 1, 0, 2, 0)


def test_only_values_that_do_not_fit_are_converted() -> None:
    codec = demo_codec("A", A="int16 whole\nfloat32 none\nfloat64 large\n")
    cdr = codec.encode(json_wire('{"whole": 3.0, "none": "NaN", "large": -Infinity}'))
    whole, none, large = struct.unpack("<h2xfd", cdr[4:])
    assert (whole, none != none, large) == (3, True, float("-inf"))


@pytest.mark.parametrize(
    ("value", "field"),
    [
        ({"inner": {"n": 128}}, "inner.n"),
        ({"inner": {"when": "soon"}}, "inner.when"),
        ({"inner": {"n": 1, "when": {"nanosec": -1}}}, "inner.when.nanosec"),
        ({"pair": [{}, {"n": 128}]}, "pair[1].n"),
        ({"pair": [{}]}, "pair"),
        ({"few": [{}, {}, {}]}, "few"),
        ({"times": ["1970-01-01T00:00:01", "soon"]}, "times[1]"),
    ],
)
def test_error_in_nested_message_names_the_whole_path(value: object, field: str) -> None:
    text = "Inner inner\nInner[2] pair\nInner[<=2] few\nbuiltin_interfaces/Time[] times\n"
    codec = demo_codec("A", A=text, Inner="int8 n\nbuiltin_interfaces/Time when\n")
    assert encoding_error(codec, value).field == field


def test_short_json_cannot_become_a_huge_message(codec: CodecOf, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "MAX_CDR", 10_000)
    goals = codec("nav_msgs/Goals")
    assert len(goals.encode(json_wire('{"goals": [' + ",".join(["{}"] * 100) + "]}"))) < 10_000
    error = encoding_error(goals, '{"goals": [' + ",".join(["{}"] * 200) + "]}")
    assert error.field == "goals"
    assert "larger than 10000 bytes" in str(error)
