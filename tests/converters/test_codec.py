"""JSON to CDR and back: accepted input, rejected input, and the field that errors name."""

from __future__ import annotations

import json
import struct

import msgspec
import pytest

from converters import ImageFormat, TypeRegistry, Wire
from converters import codec as codec_module
from rce.errors import ConversionError, RceError
from rce.protocol.names import parse_type
from tests.support.converters.conversions import CodecOf, encoding_error, json_wire, round_trip


def test_bytes_of_a_pose(codec: CodecOf) -> None:
    """The expected bytes are derived by hand from the CDR rules: doubles are aligned to 8 bytes."""
    stamp = {"sec": 1, "nanosec": 2}
    value = {"header": {"stamp": stamp, "frame_id": "map"}, "pose": {"position": {"x": 1, "z": -2.5}}}
    cdr = codec("geometry_msgs/PoseStamped").encode(json_wire(json.dumps(value)))
    assert cdr == b"\0\1\0\0" + struct.pack("<iII4s", 1, 2, 4, b"map\0") + struct.pack("<7d", 1, 0, -2.5, 0, 0, 0, 1)


def test_missing_fields_get_defaults(codec: CodecOf) -> None:
    value = round_trip(codec("geometry_msgs/Pose"), {"position": {"x": 1}})
    assert value == {
        "position": {"x": 1.0, "y": 0.0, "z": 0.0},
        "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    }
    assert round_trip(codec("sensor_msgs/NavSatStatus"), {}) == {"status": -2, "service": 0}


def test_any_buffer_type_is_accepted(codec: CodecOf) -> None:
    string = codec("std_msgs/String")
    for raw in (b'{"data":"a"}', bytearray(b'{"data":"a"}'), memoryview(b'{"data":"a"}'), msgspec.Raw(b'{"data":"a"}')):
        assert string.encode(Wire(False, raw, {})) == b"\0\1\0\0\2\0\0\0a\0"
    for cdr in (b"\0\1\0\0\2\0\0\0a\0", memoryview(bytearray(b"\0\1\0\0\2\0\0\0a\0"))):
        assert string.decode(cdr) == Wire(False, b'{"data":"a"}', {})


@pytest.mark.parametrize(
    "raw",
    [
        b"",
        b" ",
        b"{",
        b"[]",
        b"null",
        b"5",
        b'"x"',
        b"{}x",
        b'{"data":}',
        b'{"data":"\xff"}',
        b'{"data":"\xed\xa0\x80"}',
        b'{"data":"\\ud800"}',
        b'{"data":"\\ud800\\u0041"}',
        b'{"data":"\\udc00x"}',
        b'{"data":"a',
        b"\xef\xbb\xbf{}",
        b'{"x":' + b"[" * 200_000,
        b'{"x":' + b'{"x":' * 100_000,
        b'{"x":' * 100_000 + b"NaN",
        b"NaN",
        b'{"data":NaN',
        b'{"data":"' + b'\\"' * 100_000 + b" NaN",
        b'{"data":' + b"9" * 5000 + b"}",
        b"-Infinity" * 10_000,
        b'{"\0":1}',
        b'{"data":"a\nb"}',
        b"\x00",
        b"{'data':1}",
    ],
)
def test_malformed_json_is_rejected(codec: CodecOf, raw: bytes) -> None:
    encoding_error(codec("std_msgs/String"), raw)


def test_last_of_duplicate_keys_wins(codec: CodecOf) -> None:
    assert round_trip(codec("std_msgs/String"), '{"data": "a", "data": "b"}') == {"data": "b"}


def test_errors_are_rce_errors(codec: CodecOf) -> None:
    assert isinstance(encoding_error(codec("std_msgs/String"), "5"), RceError)


def test_misplaced_blobs_are_rejected(codec: CodecOf) -> None:
    cloud, one, two = codec("sensor_msgs/PointCloud2"), "0" * 32, "1" * 32
    cases: dict[str, dict[str, bytes]] = {
        f'{{"data*":"{one}"}}': {},
        f'{{"data*":"{one}"}} ': {two: b""},
        f'{{"width*":"{one}"}}': {one: b""},
        f'{{"data*":["{one}"]}}': {one: b""},
        '{"data*":5}': {},
        f'{{"data*":"{one}"}}  ': {one: b"", two: b""},
    }
    for raw, blobs in cases.items():
        with pytest.raises(ConversionError):
            cloud.encode(Wire(False, raw.encode(), blobs))
    with pytest.raises(ConversionError, match="Forwarder"):
        cloud.encode(Wire(True, f'"{one}"'.encode(), {one: b""}))


@pytest.mark.parametrize(
    ("type", "image_format", "fast", "slow"),
    [
        ("std_msgs/String", "png", 1 << 20, (1 << 20) + 1),
        ("std_msgs/Float32MultiArray", "png", 1 << 15, (1 << 15) + 1),  # its layout has a list of messages
        ("sensor_msgs/LaserScan", "png", 1 << 17, (1 << 17) + 1),
        ("geometry_msgs/PoseArray", "png", 1 << 15, (1 << 15) + 1),
        ("sensor_msgs/Image", "png", 1 << 15, (1 << 15) + 1),
        ("sensor_msgs/Image", "json", 1 << 20, (1 << 20) + 1),
    ],
)
def test_finer_types_are_slow_from_smaller_sizes(
    registry: TypeRegistry, type: str, image_format: ImageFormat, fast: int, slow: int
) -> None:
    codec = registry.message(parse_type(type), image_format)
    assert (codec.decodes_fast(bytes(fast)), codec.decodes_fast(bytes(slow))) == (True, False)
    for size, expected in ((fast, True), (slow, False)):
        assert codec.encodes_fast(Wire(False, bytes(size), {})) == expected


def test_small_picture_may_be_slow_and_a_blob_of_bytes_is_copied_fast(registry: TypeRegistry) -> None:
    image, data = (
        registry.message(parse_type(f"{each}")) for each in ("sensor_msgs/Image", "std_msgs/UInt8MultiArray")
    )
    assert not image.encodes_fast(Wire(True, b"", {"id": bytes(10)}))
    assert data.encodes_fast(Wire(False, b"{}", {"id": bytes(100_000)}))
    assert not data.encodes_fast(Wire(False, b"{}", {"id": bytes(10_000_000)}))


def test_message_larger_than_a_link_carries_is_rejected(monkeypatch: pytest.MonkeyPatch, codec: CodecOf) -> None:
    monkeypatch.setattr(codec_module, "MAX_CDR", 1000)
    with pytest.raises(ConversionError, match="larger than 1000 bytes"):
        codec("std_msgs/Float64MultiArray").encode(json_wire(json.dumps({"data": [0] * 125})))


def test_original_robot_gets_pictures_with_their_stamp(registry: TypeRegistry) -> None:
    header = {"stamp": {"sec": 5, "nanosec": 7}, "frame_id": "camera"}
    value = {"header": header, "height": 1, "width": 1, "encoding": "mono8", "step": 1, "data": [9]}
    plain = registry.message(parse_type("sensor_msgs/Image"))
    cdr = plain.encode(json_wire(json.dumps(value)))
    wire = registry.message(parse_type("sensor_msgs/Image"), dialect="original").decode(cdr)
    assert plain.encode(wire) == cdr
