"""Selection of fields: what is read, and how wrong paths are refused."""

from __future__ import annotations

import json
from typing import Any

import pytest

from converters import TypeRegistry, Wire
from converters.reader import Readers
from converters.selection import select, unwanted
from converters.wire import Outgoing
from rce.errors import InvalidRequest
from rce.protocol.names import parse_type

REGISTRY = TypeRegistry()
TWIST = {"linear": {"x": 1.0, "y": 2.0, "z": 3.0}, "angular": {"x": 4.0, "y": 5.0, "z": 6.0}}
ODOMETRY: dict[str, Any] = {
    "header": {"stamp": {"sec": 7, "nanosec": 8}, "frame_id": "map"},
    "child_frame_id": "base",
    "pose": {
        "pose": {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    },
    "twist": {"twist": TWIST},
}


def read(type: str, value: object, *fields: str) -> Any:
    codec = REGISTRY.message(parse_type(type), "json")
    cdr = codec.encode(Wire(False, json.dumps(value).encode(), {}))
    message = select(codec.message, fields)
    found, end = Readers("json").top(message)(memoryview(cdr)[4:], 0, Outgoing())
    assert end == len(cdr) - 4, "the reader has not passed the whole message"
    return json.loads(codec._encoder.encode(found))


def test_only_wanted_scalars_strings_and_structs_are_read() -> None:
    got = read("nav_msgs/Odometry", ODOMETRY, "header.stamp", "pose.pose.position", "twist.twist.angular.z")
    assert got == {
        "header": {"stamp": {"sec": 7, "nanosec": 8}},
        "pose": {"pose": {"position": {"x": 1.0, "y": 2.0, "z": 3.0}}},
        "twist": {"twist": {"angular": {"z": 6.0}}},
    }
    assert read("nav_msgs/Odometry", ODOMETRY, "child_frame_id") == {"child_frame_id": "base"}


def test_field_of_each_element_of_an_array_is_read() -> None:
    markers = [
        {"ns": f"n{i}", "id": i, "text": "x" * i, "points": [{"x": 1.0}] * i, "colors": [{"a": 0.5}]} for i in range(3)
    ]
    value = {"markers": markers}
    assert read("visualization_msgs/MarkerArray", value, "markers.id", "markers.text") == {
        "markers": [{"id": i, "text": "x" * i} for i in range(3)]
    }


def test_arrays_of_numbers_and_strings_are_skipped() -> None:
    value = {"name": ["a", "bb", ""], "position": [1.0, 2.0, 3.0], "velocity": [0.5], "effort": [9.0, 8.0]}
    assert read("sensor_msgs/JointState", value, "velocity") == {"velocity": [0.5]}
    assert read("sensor_msgs/JointState", value, "effort", "name") == {"name": ["a", "bb", ""], "effort": [9.0, 8.0]}


def test_longer_path_adds_nothing_to_a_shorter_one_in_any_order() -> None:
    for fields in (("header", "header.stamp.sec"), ("header.stamp.sec", "header")):
        assert read("nav_msgs/Odometry", ODOMETRY, *fields) == {"header": ODOMETRY["header"]}


def test_nothing_of_an_unwanted_type_is_read() -> None:
    message = unwanted(REGISTRY.message(parse_type("nav_msgs/Odometry")).message)
    assert not any(member.wanted for member in message.members)


@pytest.mark.parametrize(
    ("type", "path", "reason"),
    [
        ("geometry_msgs/Twist", "linaer.x", "did you mean linear?"),
        ("geometry_msgs/Twist", "linear.x.y", "linear.x is a float64, which has no fields"),
        ("geometry_msgs/Twist", "q", "it has linear, angular"),
    ],
)
def test_unknown_field_is_refused_with_the_nearest_one(type: str, path: str, reason: str) -> None:
    with pytest.raises(InvalidRequest, match=reason.replace("?", r"\?")):
        select(REGISTRY.message(parse_type(type)).message, [path])


def test_fields_of_an_image_that_is_a_file_are_refused() -> None:
    image = REGISTRY.message(parse_type("sensor_msgs/Image")).message
    with pytest.raises(InvalidRequest, match="use the format json"):
        select(image, ["header"], pictures=True)
    assert select(image, ["header"]).members[0].wanted
