"""Messages as ROS 1 serializes them, compared with rosbags' reader and writer for the definitions of ROS 1 Noetic."""

from __future__ import annotations

import json
import random
import struct
from contextlib import suppress
from typing import Any

import msgspec
import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from converters import Codec, TypeRegistry, Wire
from converters.model import Message, Models
from converters.ros1 import Ros1Codec
from converters.ros1_steps import HEADER, LACKING
from converters.types import common_definitions
from rce.errors import ConversionError, InvalidRequest
from rce.protocol.names import parse_type
from tests.support.converters.conversions import demo_codec, json_wire
from tests.support.converters.random_json import sample

NOETIC = get_typestore(Stores.ROS1_NOETIC)
MODELS = Models(lambda name: common_definitions()[name])
SHARED = sorted(set(NOETIC.fielddefs) & {name for name in common_definitions() if "/msg/" in name})
ID = "0a" * 16


def codec(name: str) -> Codec:
    return TypeRegistry().message(parse_type(name), "json")


def blob(data: bytes) -> Wire:
    return Wire(True, f'"{ID}"'.encode(), {ID: data})


def to_ros1(cdr: bytes, codec: Codec) -> bytes:
    (data,) = Ros1Codec(codec).decode(cdr).blobs.values()
    return bytes(data)


def refusal(codec: Codec, data: bytes) -> str:
    with pytest.raises(ConversionError) as caught:
        Ros1Codec(codec).encode(blob(data))
    assert len(str(caught.value)) < 400
    return str(caught.value)


def shared(message: Message, value: Any) -> Any:
    """Return a message without the fields that ROS 1 lacks, also within."""
    found = {}
    for member in message.members:
        name, inside = member.field.name, member.message
        if name in LACKING.get(message.name, ()):
            continue
        one = value[name]
        if inside is not None:
            one = [shared(inside, each) for each in one] if isinstance(one, list) else shared(inside, one)
        found[name] = one
    return found


@pytest.mark.parametrize("name", SHARED)
def test_every_common_type_is_as_noetic_has_it(name: str) -> None:
    plain, rng = codec(name), random.Random(name)
    for _ in range(2):
        message = shared(MODELS.message(name), sample(MODELS.message(name), rng))
        message = json.loads(json.dumps(message).replace('"NaN"', "1.5"))  # a NaN is not equal to itself
        cdr = plain.encode(json_wire(json.dumps(message)))
        data = to_ros1(cdr, plain)
        read = NOETIC.deserialize_ros1(data, name)  # refuses bytes that are left over
        assert bytes(NOETIC.serialize_ros1(read, name)) == data
        assert Ros1Codec(plain).encode(blob(data)) == cdr


def test_sequence_number_of_a_header_is_skipped_and_is_zero_on_the_way_back() -> None:
    data = struct.pack("<IIII", 77, 12, 34, 3) + b"map"
    plain = codec("std_msgs/Header")
    cdr = Ros1Codec(plain).encode(blob(data))
    assert json.loads(bytes(plain.decode(cdr).raw)) == {"stamp": {"sec": 12, "nanosec": 34}, "frame_id": "map"}
    assert to_ros1(cdr, plain) == bytes(4) + data[4:]


def test_headers_within_lists_have_their_sequence_number() -> None:
    transforms = codec("tf2_msgs/TFMessage")
    noetic = NOETIC.types
    header = noetic[HEADER](seq=5, stamp=noetic["builtin_interfaces/msg/Time"](1, 2), frame_id="odom")
    vector, turn = noetic["geometry_msgs/msg/Vector3"](1, 2, 3), noetic["geometry_msgs/msg/Quaternion"](0, 0, 0, 1)
    transform = noetic["geometry_msgs/msg/Transform"](vector, turn)
    stamped = noetic["geometry_msgs/msg/TransformStamped"](header, "base", transform)
    one = bytes(NOETIC.serialize_ros1(stamped, "geometry_msgs/msg/TransformStamped"))
    data = struct.pack("<I", 3) + 3 * one
    found = json.loads(bytes(transforms.decode(Ros1Codec(transforms).encode(blob(data))).raw))["transforms"]
    assert [each["child_frame_id"] for each in found] == ["base"] * 3
    assert found[2]["header"] == {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "odom"}
    assert found[2]["transform"]["translation"]["z"] == 3


def test_fields_that_ros1_lacks_are_zero_and_are_left_out_on_the_way_back() -> None:
    marker = codec("visualization_msgs/Marker")
    full = {"ns": "a", "text": "hi", "mesh_resource": "m", "texture_resource": "t", "texture": {"format": "png"}}
    data = to_ros1(marker.encode(json_wire(json.dumps(full))), marker)
    read: Any = NOETIC.deserialize_ros1(data, "visualization_msgs/msg/Marker")
    assert (read.ns, read.text, read.mesh_resource) == ("a", "hi", "m")
    back = json.loads(bytes(marker.decode(Ros1Codec(marker).encode(blob(data))).raw))
    assert (back["text"], back["texture_resource"], back["texture"]["format"]) == ("hi", "", "")


def test_large_arrays_keep_their_bytes() -> None:
    scan = codec("sensor_msgs/LaserScan")
    ranges = np.linspace(0, 10, 1080, dtype=np.float32)
    cdr = scan.encode(json_wire(json.dumps({"ranges": ranges.tolist(), "header": {"frame_id": "x"}})))
    read: Any = NOETIC.deserialize_ros1(to_ros1(cdr, scan), "sensor_msgs/msg/LaserScan")
    assert np.array_equal(read.ranges, ranges)


def test_services_have_both_halves() -> None:
    service = TypeRegistry().service(parse_type("std_srvs/SetBool"))
    assert Ros1Codec(service.request).encode(blob(b"\1")) == b"\0\1\0\0\1"
    data = struct.pack("<?I", True, 2) + b"ok"
    cdr = Ros1Codec(service.response).encode(blob(data))
    assert json.loads(bytes(service.response.decode(cdr).raw)) == {"success": True, "message": "ok"}


def test_empty_request_has_no_bytes() -> None:
    request = TypeRegistry().service(parse_type("std_srvs/Trigger")).request
    cdr = Ros1Codec(request).encode(blob(b""))
    assert cdr == request.encode(json_wire("{}"))
    assert to_ros1(cdr, request) == b""


def test_own_types_are_converted_with_their_own_fields() -> None:
    plain = demo_codec(
        "Outer", Outer="uint8 a\nInner[2] pair\nInner[] more\nstring[2] names", Inner="float64 x\nbool b"
    )
    message = {"a": 1, "pair": [{"x": 1}, {"b": True}], "more": [{"x": 2.5}], "names": ["p", "qq"]}
    cdr = plain.encode(json_wire(json.dumps(message)))
    data = to_ros1(cdr, plain)
    assert data == struct.pack("<Bd?d?Id?I1sI2s", 1, 1, False, 0, True, 1, 2.5, False, 1, b"p", 2, b"qq")
    assert Ros1Codec(plain).encode(blob(data)) == cdr


def test_recipe_names_the_conversion() -> None:
    made = Ros1Codec(codec("std_msgs/String"))
    assert made.recipe == msgspec.structs.replace(codec("std_msgs/String").recipe, converter="ros1")


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "std_msgs/msg/String data: .* the data ends within the message"),
        (b"\x05\0\0\0hell", "exceeds the remaining data"),
        (b"\x01\0\0\0hi", "1 bytes follow the message"),
        (b"\x02\0\0\0\xff\xfe", "not utf-8"),
        (b"\x02\0\0\0a\0", "U\\+0000"),
        (b"\0\1\0\0\3\0\0\0hi\0", "begins like CDR of ROS 2.*remove the format ros1"),
        (b"\x78\x9c\x4b", "begins like zlib.*set gzip_lvl to 0"),
    ],
)
def test_wrong_bytes_are_refused_with_the_reason(data: bytes, reason: str) -> None:
    with pytest.raises(ConversionError, match=reason):
        Ros1Codec(codec("std_msgs/String")).encode(blob(data))


def test_error_has_the_path_of_the_field() -> None:
    plain = codec("nav_msgs/Path")
    header = struct.pack("<IIII", 0, 0, 0, 0)
    data = header + struct.pack("<I", 2) + header + bytes(56) + struct.pack("<IIII", 0, 0, 0, 1 << 20) + bytes(56)
    assert "poses[1].header.frame_id" in refusal(plain, data)


def test_length_beyond_the_data_is_refused_at_once() -> None:
    polygon = codec("geometry_msgs/Polygon")
    assert "the length 4294967295 exceeds" in refusal(polygon, struct.pack("<I", 0xFFFFFFFF) + bytes(24))


def test_message_of_other_than_one_blob_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="one blob"):
        Ros1Codec(codec("std_msgs/String")).encode(json_wire("{}"))


def test_cdr_of_another_type_is_refused() -> None:
    plain = codec("std_msgs/String")
    for cdr in (b"\0\1\0\0\xff\0\0\0", b"\0\0\0\0\0\0\0\1\0", b""):
        with pytest.raises(ConversionError, match="not CDR of this type"):
            Ros1Codec(plain).decode(cdr)


def test_random_bytes_are_refused_or_converted_but_never_crash() -> None:
    rng = random.Random(1)
    made = [Ros1Codec(codec(name)) for name in ("nav_msgs/Odometry", "sensor_msgs/PointCloud2", "tf2_msgs/TFMessage")]
    for number in range(600):
        data = rng.randbytes(rng.randint(0, 200))
        with suppress(ConversionError):
            made[number % 3].encode(blob(data))
