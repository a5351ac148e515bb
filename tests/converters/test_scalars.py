"""Numbers, times and durations: accepted forms and ranges."""

from __future__ import annotations

import json

import pytest

from tests.support.converters.conversions import CodecOf, encoding_error, round_trip


@pytest.mark.parametrize(
    ("stamp", "sec", "nanosec"),
    [
        ('{"sec": 5, "nanosec": 7}', 5, 7),
        ('"1970-01-01T00:00:01"', 1, 0),
        ('"2026-11-21T10:00:00.123456"', 1795255200, 123456000),
        ('"2026-11-21T10:00:00.123456789Z"', 1795255200, 123456789),
        ('"2026-11-21 12:30:00+02:30"', 1795255200, 0),
        ('"2026-11-21T05:00:00-0500"', 1795255200, 0),
        ('"1969-12-31T23:59:59.25"', -1, 250000000),
        ('"2024-02-29T00:00:00"', 1709164800, 0),
    ],
)
def test_times_in_both_forms(codec: CodecOf, stamp: str, sec: int, nanosec: int) -> None:
    expected = {"sec": sec, "nanosec": nanosec}
    assert round_trip(codec("std_msgs/Header"), f'{{"stamp": {stamp}}}') == {"stamp": expected, "frame_id": ""}
    assert round_trip(codec("builtin_interfaces/Time"), stamp) == expected
    assert encoding_error(codec("std_msgs/Header"), '{"stamp": 5}').field == "stamp"


@pytest.mark.parametrize(
    "stamp",
    [
        "",
        "now",
        "2026-11-21",
        "2026-02-29T00:00:00",
        "2026-13-01T00:00:00",
        "2026-00-01T00:00:00",
        "2026-01-00T00:00:00",
        "2026-11-21T24:00:00",
        "2026-11-21T10:60:00",
        "2026-11-21T10:00:60",
        "0000-01-01T00:00:00",
        "9999-12-31T23:59:59",
        "2038-01-19T03:14:08",
        "2026-11-21T10:00:00.1234567890",
        "٢٠٢٦-11-21T10:00:00",
        "9" * 100_000,
    ],
)
def test_malformed_time_is_rejected(codec: CodecOf, stamp: str) -> None:
    assert encoding_error(codec("nav_msgs/Path"), {"poses": [{}, {"header": {"stamp": stamp}}]}).field.startswith(
        "poses[1].header.stamp"
    )


@pytest.mark.parametrize(
    ("seconds", "sec", "nanosec"),
    [
        ("1", 1, 0),
        ("1.5", 1, 500000000),
        ("-0.25", -1, 750000000),
        ("0.9999999999", 1, 0),
        ("-2147483648", -(2**31), 0),
    ],
)
def test_durations_in_seconds(codec: CodecOf, seconds: str, sec: int, nanosec: int) -> None:
    point = round_trip(codec("trajectory_msgs/JointTrajectoryPoint"), f'{{"time_from_start": {seconds}}}')
    assert point["time_from_start"] == {"sec": sec, "nanosec": nanosec}


@pytest.mark.parametrize("seconds", ["2147483648", "1e300", '"NaN"', "NaN", "true", '"1.5"', "9" * 400])
def test_malformed_duration_is_rejected(codec: CodecOf, seconds: str) -> None:
    point = codec("trajectory_msgs/JointTrajectoryPoint")
    assert encoding_error(point, f'{{"time_from_start": {seconds}}}').field.startswith("time_from_start")


def test_non_finite_numbers_round_trip(codec: CodecOf) -> None:
    raw = '{"x": NaN, "y": -Infinity, "theta": Infinity}'
    assert round_trip(codec("geometry_msgs/Pose2D"), raw) == {"x": "NaN", "y": "-Infinity", "theta": "Infinity"}
    assert round_trip(codec("geometry_msgs/Pose2D"), round_trip(codec("geometry_msgs/Pose2D"), raw)) == json.loads(
        '{"x": "NaN", "y": "-Infinity", "theta": "Infinity"}'
    )
    ranges = ["NaN", 1.0, "Infinity", "-Infinity"]
    scan = '{"ranges": [NaN, 1, Infinity, "-Infinity"], "header": {"frame_id": "NaN \\"Infinity\\\\"}}'
    value = round_trip(codec("sensor_msgs/LaserScan"), scan)
    assert value["ranges"] == ranges
    assert value["header"]["frame_id"] == 'NaN "Infinity\\'


@pytest.mark.parametrize(
    ("name", "raw"),
    [
        ("std_msgs/Float64", "nan"),
        ("std_msgs/Float64", "+Infinity"),
        ("std_msgs/Float64", "-NaN"),
        ("std_msgs/Float64", "inf"),
        ("std_msgs/Float64", '"nan"'),
        ("std_msgs/Float64", '"1.5"'),
        ("std_msgs/Int32", "NaN"),
        ("std_msgs/Int32", '"NaN"'),
        ("std_msgs/String", "NaN"),
        ("std_msgs/Bool", "Infinity"),
        ("std_msgs/Float64", "Infinity1"),
        ("std_msgs/Float64", "1e999"),
    ],
)
def test_invalid_number_tokens_are_rejected(codec: CodecOf, name: str, raw: str) -> None:
    encoding_error(codec(name), f'{{"data": {raw}}}')


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("Int8", 128),
        ("Int8", -129),
        ("UInt8", -1),
        ("UInt8", 256),
        ("UInt16", 65536),
        ("Int32", 2**31),
        ("UInt64", 2**64),
        ("Int64", -(2**63) - 1),
        ("Int32", 1.5),
        ("Int32", 1e30),
        ("Int32", True),
        ("Bool", 1),
        ("Bool", "true"),
        ("Float32", 1e39),
        ("Float64", True),
        ("Float64", None),
        ("String", 5),
        ("String", "a\0b"),
        ("Int32", 10**4000),
        ("Byte", 256),
        ("Char", -1),
        ("Float64", [1.0]),
        ("String", {}),
        ("Int32", None),
    ],
)
def test_value_out_of_range_is_rejected(codec: CodecOf, name: str, value: object) -> None:
    assert encoding_error(codec(f"std_msgs/{name}"), {"data": value}).field == "data"


def test_integers_may_be_written_as_floats_and_floats_as_integers(codec: CodecOf) -> None:
    assert round_trip(codec("std_msgs/Int32"), '{"data": 3.0}') == {"data": 3}
    assert round_trip(codec("std_msgs/Int16MultiArray"), '{"data": [1.0, -2, 3e2]}')["data"] == [1, -2, 300]
    assert round_trip(codec("std_msgs/Float64"), '{"data": 3}') == {"data": 3.0}
    assert round_trip(codec("std_msgs/UInt64"), '{"data": 18446744073709551615}') == {"data": 2**64 - 1}
