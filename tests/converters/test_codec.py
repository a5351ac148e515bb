"""JSON to CDR and back: accepted input, rejected input, and the field that errors name."""

from __future__ import annotations

import json
import struct

import msgspec
import pytest

from converters import Wire
from rce.errors import ConversionError, RceError
from tests.support.converters.conversions import CodecOf, encoding_error, json_wire, round_trip


def test_bytes_of_a_pose(codec: CodecOf) -> None:
    """The expected bytes are derived by hand from the CDR rules: doubles are aligned to 8 bytes."""
    stamp = {"sec": 1, "nanosec": 2}
    value = {"header": {"stamp": stamp, "frame_id": "map"}, "pose": {"position": {"x": 1, "z": -2.5}}}
    cdr = codec("geometry_msgs/PoseStamped").encode(json_wire(json.dumps(value)))
    assert cdr == b"\0\1\0\0" + struct.pack("<iII4s", 1, 2, 4, b"map\0") + struct.pack("<7d", 1, 0, -2.5, 0, 0, 0, 1)


def test_missing_fields_get_defaults_and_unknown_ones_are_ignored(codec: CodecOf) -> None:
    value = round_trip(codec("geometry_msgs/Pose"), {"position": {"x": 1}, "colour": {"deep": [1, {"x": None}]}})
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
