"""Conversion between Python values and frames: blobs, arrays, NaN and infinities."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from rce.client.values import decode_message, encode, encode_message
from rce.errors import InvalidRequest
from rce.protocol.messages import DataMessage, decode_as, decode_frame
from tests.support.client_contract import STRING
from tests.support.fake_platform import FakePlatform

SCAN = "sensor_msgs/LaserScan"


def round_trip(value: Any, type_name: str = SCAN) -> Any:
    text, blobs = encode_message("tag", type_name, "nil", value)
    frame = decode_frame(text)
    return decode_message(decode_as(DataMessage, frame.data, "DM"), blobs)


def test_nan_and_infinities_round_trip() -> None:
    result = round_trip({"ranges": [1.0, math.inf, -math.inf], "max": math.inf, "deep": [{"x": math.nan}], "s": "null"})
    assert result["ranges"] == [1.0, math.inf, -math.inf]
    assert result["max"] == math.inf
    assert math.isnan(result["deep"][0]["x"])


def test_strings_named_infinity_stay_strings() -> None:
    assert round_trip({"data": "Infinity"}, STRING) == {"data": "Infinity"}
    assert round_trip({"data": "to Infinity"}) == {"data": "to Infinity"}


def test_numpy_arrays_become_lists() -> None:
    value = {
        "ranges": np.array([1.5, np.inf], np.float32),
        "angle": np.float32(0.5),
        "n": np.int64(3),
        "m": np.eye(2),
        "b": np.bool_(True),
    }
    assert round_trip(value) == {"ranges": [1.5, math.inf], "angle": 0.5, "n": 3, "m": [[1, 0], [0, 1]], "b": True}


def test_bytes_at_any_depth_become_blobs() -> None:
    value = {"data": b"\0\1", "parts": [{"x": bytearray(b"2")}, {"x": memoryview(b"3")}], "many": [b"4", b""]}
    text, blobs = encode_message("tag", "a/B", "nil", value)
    assert len(blobs) == 5
    assert set(json.loads(text)["data"]["msg"]) == {"data*", "parts", "many*"}
    assert round_trip(value) == {"data": b"\0\1", "parts": [{"x": b"2"}, {"x": b"3"}], "many": [b"4", b""]}
    assert round_trip(b"whole") == b"whole"


@pytest.mark.parametrize("value", [object(), {"x": 2**70, "y": object()}, {1, object()}, {"a": [[b"x"]]}])
def test_value_without_json_representation_is_rejected(value: object) -> None:
    with pytest.raises(InvalidRequest):
        encode_message("tag", "a/B", "nil", {"x": value})


def test_circular_value_is_rejected() -> None:
    value: list[Any] = []
    value.append(value)
    with pytest.raises(InvalidRequest):
        encode(value)


async def test_message_with_nested_blobs_is_delivered(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        publisher = await a.publisher("out", "sensor_msgs/PointCloud2")
        subscriber = await a.subscriber("in", "sensor_msgs/PointCloud2", to="a/out")
        cloud = {"width": 2, "data": bytes(1_000_000), "fields": [{"name": "x", "extra": b"blob"}]}
        await publisher.publish(cloud)
        assert await subscriber.get(10) == cloud
