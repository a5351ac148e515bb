"""Types added to a registry by their definitions."""

from __future__ import annotations

import json

import pytest

from converters import Codec, TypeRegistry
from rce.errors import AlreadyExists, InvalidRequest, UnknownType
from rce.protocol.names import parse_type
from tests.support.converters.conversions import json_wire, round_trip

EVERYTHING = """
# A comment.
uint8 RED=1  # constants take no room
string NAME = "a # b"
int32 count 7
float32 ratio 0.5   # half
bool on true
string name "x # y"
string<=5 short
wstring wide "Grüße"
int16[] many [1, -2]
float64[3] three [1.0, 2.0, 3.0]
string[] words ["a", "b"]
string<=2[<=2] few
uint8[4] bytes
Inner inner
Inner[2] pair
demo/Inner[<=2] some
geometry_msgs/Point[] points
Header header
builtin_interfaces/Time[] times
wstring[] wides
"""
INNER = "int8 a -1\r\nfloat64 b\r\n"


def registry_with(**definitions: str) -> TypeRegistry:
    registry = TypeRegistry()
    registry.add({f"demo/msg/{name}": definition for name, definition in definitions.items()})
    return registry


def message(registry: TypeRegistry, name: str) -> Codec:
    return registry.message(parse_type(name))


def test_all_features_of_definitions() -> None:
    codec = message(registry_with(Everything=EVERYTHING, Inner=INNER), "demo/Everything")
    inner = {"a": -1, "b": 0.0}
    assert round_trip(codec, {}) == {
        "count": 7, "ratio": 0.5, "on": True, "name": "x # y", "short": "", "wide": "Grüße", "many": [1, -2],
        "three": [1.0, 2.0, 3.0], "words": ["a", "b"], "few": [], "bytes": "AAAAAA==", "inner": inner,
        "pair": [inner, inner], "some": [], "points": [], "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        "times": [], "wides": [],
    }  # fmt: skip
    value = {
        "times": ["1970-01-01T00:00:01", {"sec": 2}],
        "wides": ["", "a😀"],
        "pair": [{"a": 1}, {}],
        "points": [{"x": 1}],
    }
    found = round_trip(codec, value)
    assert found["times"] == [{"sec": 1, "nanosec": 0}, {"sec": 2, "nanosec": 0}]
    assert found["wides"] == ["", "a😀"]
    assert found["pair"][0] == {"a": 1, "b": 0.0}
    assert found["points"] == [{"x": 1.0, "y": 0.0, "z": 0.0}]


@pytest.mark.parametrize(
    ("value", "field"),
    [
        ({"short": "Grüße"}, "short"),  # seven bytes
        ({"few": ["abc"]}, "few[0]"),
        ({"few": ["a", "b", "c"]}, "few"),
        ({"pair": [{}]}, "pair"),
        ({"pair": [{}, {"a": 128}]}, "pair[1].a"),
        ({"some": [{}, {}, {}]}, "some"),
        ({"times": ["1970-01-01T00:00:01", "soon"]}, "times[1]"),
        ({"bytes": "AAAA"}, "bytes"),
    ],
)
def test_bounds_are_enforced(value: object, field: str) -> None:
    codec = message(registry_with(Everything=EVERYTHING, Inner=INNER), "demo/Everything")
    with pytest.raises(InvalidRequest) as caught:
        codec.encode(json_wire(json.dumps(value)))
    assert caught.value.field == field


def test_wide_strings_have_the_format_of_fast_cdr() -> None:
    """The expected bytes come from Fast CDR 2.3.3: the number of UTF-16 units, the units, no terminator."""
    codec = message(registry_with(W="uint8 a\nwstring w\nuint8 b\nwstring[] v\nuint8 c\n"), "demo/W")
    cdr = codec.encode(json_wire('{"a": 1, "w": "ab€", "b": 7, "v": ["x", "", "yz"], "c": 9}'))
    assert cdr.hex(" ") == (
        "00 01 00 00 01 00 00 00 03 00 00 00 61 00 62 00 ac 20 07 00 03 00 00 00 01 00 00 00 78 00 00 00 00 00 00 00 "
        "02 00 00 00 79 00 7a 00 09"
    )


def test_empty_message_is_one_byte() -> None:
    codec = message(registry_with(Nothing="", Two="demo/Nothing[2] pair\nuint8 end\n"), "demo/Two")
    cdr = codec.encode(json_wire('{"end": 5}'))
    assert cdr == b"\0\1\0\0\0\0\5"
    assert json.loads(codec.decode(cdr).raw) == {"pair": [{}, {}], "end": 5}


def test_service_types() -> None:
    registry = TypeRegistry()
    registry.add({"demo/srv/Add": "int64 a\nint64 b\n---\nint64 sum\nInner inner\n", "demo/msg/Inner": INNER})
    add = registry.service(parse_type("demo/srv/Add"))
    assert round_trip(add.request, {"a": 1}) == {"a": 1, "b": 0}
    assert round_trip(add.response, {"sum": 3}) == {"sum": 3, "inner": {"a": -1, "b": 0.0}}
    empty = registry.service(parse_type("std_srvs/Empty"))
    assert empty.request.encode(json_wire("{}")) == empty.response.encode(json_wire("{}")) == b"\0\1\0\0\0"


def test_common_services_and_map_messages_are_known(registry: TypeRegistry) -> None:
    for name in ("std_srvs/SetBool", "nav_msgs/GetMap", "sensor_msgs/SetCameraInfo", "lifecycle_msgs/GetState",
                 "map_msgs/SaveMap", "diagnostic_msgs/SelfTest", "rcl_interfaces/SetParameters",
                 "visualization_msgs/GetInteractiveMarkers"):  # fmt: skip
        assert registry.service(parse_type(name)).request.encode(json_wire("{}"))
    for name in ("map_msgs/OccupancyGridUpdate", "tf2_msgs/TFMessage", "stereo_msgs/DisparityImage",
                 "shape_msgs/Mesh", "visualization_msgs/MarkerArray", "trajectory_msgs/JointTrajectory"):  # fmt: skip
        assert message(registry, name).encode(json_wire("{}"))


def test_equal_definition_is_skipped_and_different_one_rejected() -> None:
    registry = registry_with(Inner=INNER)
    codec = message(registry, "demo/Inner")
    registry.add({"demo/msg/Inner": "int8 a  # another comment\n\nfloat64 b 5.0", "std_msgs/msg/String": "string data"})
    assert message(registry, "demo/Inner") is codec
    for name, definition in {
        "demo/msg/Inner": "int8 a",
        "std_msgs/msg/Empty": "int8 a",
        "std_srvs/srv/Empty": "int8 a\n---\n",
    }.items():
        with pytest.raises(AlreadyExists, match="other fields"):
            registry.add({"demo/msg/New": "int8 a", name: definition})
    with pytest.raises(UnknownType):
        message(registry, "demo/New")


def test_registries_do_not_share_added_types() -> None:
    registry_with(Inner=INNER)
    with pytest.raises(UnknownType, match="demo/msg/Inner"):
        message(TypeRegistry(), "demo/Inner")


def test_type_may_be_added_after_one_that_contains_it() -> None:
    registry = registry_with(Outer="Inner inner")
    with pytest.raises(UnknownType, match="demo/msg/Inner"):
        message(registry, "demo/Outer")
    registry.add({"demo/msg/Inner": INNER})
    assert round_trip(message(registry, "demo/Outer"), {}) == {"inner": {"a": -1, "b": 0.0}}


def test_unknown_types_raise(registry: TypeRegistry) -> None:
    with pytest.raises(UnknownType):
        registry.service(parse_type("std_msgs/String"))
    with pytest.raises(UnknownType):
        registry.message(parse_type("std_srvs/Empty"))


@pytest.mark.parametrize(
    ("name", "definition"),
    [
        ("demo/Inner", "int8 a"),
        ("demo/msg/a b", "int8 a"),
        ("demo/msg/X", "int8"),
        ("demo/msg/X", "int8 a\nint16 a"),
        ("demo/msg/X", "int8[ a"),
        ("demo/msg/X", "x" * 100_000),
        ("demo/srv/X", "int8 a"),
        ("demo/srv/X", "int8 a\n---\n---\n"),
    ],
)
def test_malformed_definition_is_rejected(name: str, definition: str) -> None:
    with pytest.raises(InvalidRequest) as caught:
        TypeRegistry().add({name: definition})
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    "definition",
    [
        "X x",
        "X[] x",
        "uint8[2000000] x",
        "geometry_msgs/Point[1000000] x",
        "int8 a 200",
        "int8[2] a [1]",
        "int8 a [1]",
        "int8[<=2] a [1, 2, 3]",
        "uint8[10000000000000000000000] x",
        "float32 a x",
    ],
)
def test_unusable_definition_is_rejected(definition: str) -> None:
    with pytest.raises(InvalidRequest):
        message(registry_with(X=definition), "demo/X")


def test_size_and_depth_of_types_are_limited() -> None:
    names = [f"N{i}" for i in range(30)]
    doubling = {
        name: f"{inner} a\n{inner} b\n" for name, inner in zip(names, [*names[1:], "std_msgs/Empty"], strict=True)
    }
    registry = registry_with(**doubling)
    with pytest.raises(InvalidRequest, match="deep"):
        message(registry, "demo/N0")
    with pytest.raises(InvalidRequest, match="limit"):
        message(registry, "demo/N8")
    assert len(message(registry, "demo/N18").encode(json_wire("{}"))) == 4 + 2**12
