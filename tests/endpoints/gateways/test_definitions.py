"""Type definitions as text and as records of rosapi."""

from __future__ import annotations

from converters import TypeRegistry
from endpoints.gateways.definitions import message_text, typedefs
from rce.protocol.names import parse_type


def test_text_has_the_types_that_a_type_contains() -> None:
    definitions = TypeRegistry().definitions(parse_type("geometry_msgs/PoseStamped"), "msg")
    text = message_text(definitions, "geometry_msgs/msg/PoseStamped")
    first, *others = text.split("=" * 80 + "\n")
    assert first == "std_msgs/Header header\ngeometry_msgs/Pose pose\n"
    assert {each.splitlines()[0] for each in others} == {
        "MSG: std_msgs/Header",
        "MSG: builtin_interfaces/Time",
        "MSG: geometry_msgs/Pose",
        "MSG: geometry_msgs/Point",
        "MSG: geometry_msgs/Quaternion",
    }


def test_arrays_keep_their_lengths() -> None:
    registry = TypeRegistry()
    registry.add({"demo/msg/A": "uint8[3] a\nstring<=5[] b\nfloat32[<=2] c\n"})
    definitions = registry.definitions(parse_type("demo/A"), "msg")
    assert message_text(definitions, "demo/msg/A") == "uint8[3] a\nstring<=5[] b\nfloat32[<=2] c\n"


def test_records_have_names_types_and_lengths_of_fields() -> None:
    definitions = TypeRegistry().definitions(parse_type("sensor_msgs/Imu"), "msg")
    first, *others = typedefs(definitions, "sensor_msgs/msg/Imu")
    assert first["type"] == "sensor_msgs/Imu"
    assert first["fieldnames"][:2] == ["header", "orientation"]
    assert first["fieldtypes"][:3] == ["std_msgs/Header", "geometry_msgs/Quaternion", "float64"]
    assert first["fieldarraylen"][:3] == [-1, -1, 9]
    assert {each["type"] for each in others} >= {"std_msgs/Header", "geometry_msgs/Vector3"}
