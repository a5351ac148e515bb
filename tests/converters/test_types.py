"""Types added to a registry by their definitions."""

from __future__ import annotations

import gc
import json
import weakref

import msgspec
import pytest

from converters import Codec, Recipe, TypeRegistry, Wire
from rce.errors import AlreadyExists, InvalidRequest, UnknownType
from rce.protocol.names import parse_type
from tests.support.converters.conversions import json_wire, registry_with, round_trip

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


def test_empty_message_is_one_byte() -> None:
    codec = message(registry_with(Nothing="", Two="demo/Nothing[2] pair\nuint8 end\n"), "demo/Two")
    cdr = codec.encode(json_wire('{"end": 5}'))
    assert cdr == b"\0\1\0\0\0\0\5"
    assert json.loads(bytes(codec.decode(cdr).raw)) == {"pair": [{}, {}], "end": 5}


def test_service_types() -> None:
    registry = TypeRegistry()
    registry.add({"demo/srv/Add": "int64 a\nint64 b\n---\nint64 sum\nInner inner\n", "demo/msg/Inner": INNER})
    add = registry.service(parse_type("demo/srv/Add"))
    assert round_trip(add.request, {"a": 1}) == {"a": 1, "b": 0}
    assert round_trip(add.response, {"sum": 3}) == {"sum": 3, "inner": {"a": -1, "b": 0.0}}
    empty = registry.service(parse_type("std_srvs/Empty"))
    assert empty.request.encode(json_wire("{}")) == empty.response.encode(json_wire("{}")) == b"\0\1\0\0\0"


def test_action_types() -> None:
    registry = TypeRegistry()
    registry.add({"demo/action/Go": "Inner to\n---\nint8 cost 3\n---\nfloat64 left\n", "demo/msg/Inner": INNER})
    go = registry.action(parse_type("demo/action/Go"))
    assert round_trip(go.goal, {}) == {"to": {"a": -1, "b": 0.0}}
    assert round_trip(go.result, {}) == {"cost": 3}
    assert round_trip(go.feedback, {"left": 0.5}) == {"left": 0.5}
    with pytest.raises(InvalidRequest, match="needs exactly two lines ---"):
        registry.add({"demo/action/Stop": "---\n"})
    assert round_trip(registry.action(parse_type("example_interfaces/Fibonacci")).goal, {"order": 1}) == {"order": 1}


def test_common_services_and_map_messages_are_known(registry: TypeRegistry) -> None:
    for name in ("std_srvs/SetBool", "nav_msgs/GetMap", "sensor_msgs/SetCameraInfo", "lifecycle_msgs/GetState",
                 "map_msgs/SaveMap", "diagnostic_msgs/SelfTest", "rcl_interfaces/SetParameters",
                 "visualization_msgs/GetInteractiveMarkers", "example_interfaces/AddTwoInts"):  # fmt: skip
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


@pytest.mark.parametrize(("name", "reason"), [("demo/Inner", "ambiguous"), ("demo/msg/a b", "a b")])
def test_malformed_name_is_rejected(name: str, reason: str) -> None:
    with pytest.raises(InvalidRequest, match=reason):
        TypeRegistry().add({name: "int8 a"})


def test_nothing_is_added_if_one_definition_is_malformed() -> None:
    registry = TypeRegistry()
    with pytest.raises(InvalidRequest, match="demo/msg/Bad"):
        registry.add({"demo/msg/Inner": INNER, "demo/msg/Bad": "int8"})
    with pytest.raises(UnknownType):
        message(registry, "demo/Inner")


def test_recipe_makes_the_same_codec_elsewhere() -> None:
    registry = TypeRegistry()
    registry.add({"a/msg/Outer": "b/Inner inner\nstd_msgs/Header header", "b/msg/Inner": "a/Leaf[2] leaves"})
    registry.add({"a/msg/Leaf": "int8 x -3", "a/msg/Unused": "int8 x"})
    codec = registry.message(parse_type("a/Outer"))
    assert sorted(name for name, _ in codec.recipe.added) == ["a/msg/Leaf", "a/msg/Outer", "b/msg/Inner"]
    sent = msgspec.msgpack.decode(msgspec.msgpack.encode(codec.recipe), type=Recipe)
    assert TypeRegistry.codec_of(sent).encode(Wire(False, b"{}", {})) == codec.encode(Wire(False, b"{}", {}))
    assert registry.message(parse_type("std_msgs/String")).recipe == Recipe("std_msgs/msg/String", "png")


def test_registry_is_freed_without_the_garbage_collector() -> None:
    registry = registry_with(Inner=INNER)
    registry.message(parse_type("demo/Inner"))
    codecs = weakref.ref(registry._codecs)
    gc.disable()
    try:
        del registry
        assert codecs() is None
    finally:
        gc.enable()
