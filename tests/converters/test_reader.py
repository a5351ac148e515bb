"""Decoding of CDR: random messages in both directions, and damaged data."""

from __future__ import annotations

import json
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from converters import TypeRegistry, Wire
from converters.model import Models
from converters.types import common_definitions
from rce.errors import ConversionError
from rce.protocol.names import TypeName
from tests.support.converters.conversions import CodecOf
from tests.support.converters.random_json import sample

MODELS = Models(lambda name: common_definitions()[name])
NAMES = [name for name in sorted(common_definitions()) if "/msg/" in name]
REGISTRY = TypeRegistry()
DEEP = ("visualization_msgs/InteractiveMarkerUpdate", "rcl_interfaces/ParameterEvent", "sensor_msgs/MultiDOFJointState",
        "stereo_msgs/DisparityImage", "tf2_msgs/TFMessage", "nav_msgs/Odometry")  # fmt: skip


@given(st.sampled_from(NAMES), st.integers(0, 1 << 32))
@settings(max_examples=300, deadline=None, derandomize=True, database=None)
def test_random_message_round_trips(name: str, seed: int) -> None:
    package, _, plain = name.split("/")
    codec = REGISTRY.message(TypeName(package, plain), "json")
    value = sample(MODELS.message(name), random.Random(seed))
    cdr = codec.encode(Wire(False, json.dumps(value, ensure_ascii=bool(seed % 2)).encode(), {}))
    assert json.loads(bytes(codec.decode(cdr).raw)) == value


@pytest.mark.parametrize("name", DEEP)
def test_damaged_cdr_raises_only_conversion_errors(codec: CodecOf, name: str) -> None:
    ours, rng = codec(name), random.Random(name)
    model = MODELS.message(name.replace("/", "/msg/"))
    refused = 0
    for _ in range(150):
        data = bytearray(ours.encode(Wire(False, json.dumps(sample(model, rng)).encode(), {})))
        for _ in range(rng.randint(1, 4)):
            data[rng.randrange(4, len(data))] = rng.choice((0, 1, 127, 255, rng.randrange(256)))
        try:
            json.loads(bytes(ours.decode(data[: rng.randint(4, len(data))]).raw))
        except ConversionError:
            refused += 1
    assert refused > 50


@given(st.binary(max_size=300))
@settings(max_examples=200, deadline=None, derandomize=True, database=None)
def test_random_bytes_are_rejected_as_json(data: bytes) -> None:
    codec = REGISTRY.message(TypeName("diagnostic_msgs", "DiagnosticArray"))
    with pytest.raises(ConversionError):
        codec.encode(Wire(False, data + b"\xff", {}))


JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text()
    | st.sampled_from(["NaN", "2026-11-21T10:00:00"]),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(["header", "stamp", "sec", "pose", "position", "x", "covariance", "twist", "data*"]), inner
        )
    ),
    max_leaves=20,
)


@pytest.mark.slow
@given(JSON)
@settings(max_examples=300, deadline=None, derandomize=True, database=None)
def test_random_json_is_converted_or_rejected(value: object) -> None:
    codec = REGISTRY.message(TypeName("nav_msgs", "Odometry"))
    try:
        cdr = codec.encode(Wire(False, json.dumps(value).encode(), {}))
    except ConversionError:
        return
    assert isinstance(value, dict)
    assert json.loads(bytes(codec.decode(cdr).raw)).keys() == {"header", "child_frame_id", "pose", "twist"}


@pytest.mark.parametrize("cdr", [b"", b"\0\1", b"\0\1\0\0", b"\0\0\0\0\0\0\0\2a\0", b"\0\7\0\0\2\0\0\0a\0"])
def test_malformed_cdr_is_rejected(codec: CodecOf, cdr: bytes) -> None:
    with pytest.raises(ConversionError):
        codec("std_msgs/String").decode(cdr)


def test_length_beyond_the_data_is_rejected(codec: CodecOf) -> None:
    for name in ("std_msgs/String", "std_msgs/UInt8MultiArray", "nav_msgs/Path", "sensor_msgs/JointState"):
        with pytest.raises(ConversionError) as caught:
            codec(name).decode(b"\0\1\0\0" + b"\xff" * 40)
        assert caught.value.field


def test_error_names_the_field(codec: CodecOf) -> None:
    poses = codec("nav_msgs/Path")
    cdr = poses.encode(Wire(False, json.dumps({"poses": [{"header": {"frame_id": "abcd"}}] * 3}).encode(), {}))
    at = cdr.rindex(b"abcd")
    with pytest.raises(ConversionError) as caught:
        poses.decode(cdr[:at] + b"\xff" + cdr[at + 1 :])
    assert caught.value.field == "poses[2].header.frame_id"
    with pytest.raises(ConversionError) as caught:
        poses.decode(cdr[:-1])
    assert caught.value.field.startswith("poses[2]")


def test_string_without_terminator_is_accepted(codec: CodecOf) -> None:
    """Some writers omit it; Fast CDR accepts such strings too."""
    assert codec("std_msgs/String").decode(b"\0\1\0\0\2\0\0\0ab").raw == b'{"data":"ab"}'
    assert codec("std_msgs/String").decode(b"\0\1\0\0\0\0\0\0").raw == b'{"data":""}'
