"""Messages as Python values: blobs inside dicts, arrays, and the floats that JSON does not have."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from client_contract import STRING
from fake_platform import FakePlatform

from rce.client import Robot
from rce.client.values import decode_message, encode, encode_message
from rce.errors import InvalidRequest
from rce.messages import DataMessage, decode_as, decode_frame

SCAN = "sensor_msgs/LaserScan"


def through(value: Any, type_name: str = SCAN) -> Any:
    text, blobs = encode_message("tag", type_name, "nil", value)
    frame = decode_frame(text)
    return decode_message(decode_as(DataMessage, frame.data, "DM"), blobs)


def test_floats_that_json_does_not_have_come_through() -> None:
    result = through({"ranges": [1.0, math.inf, -math.inf], "max": math.inf, "deep": [{"x": math.nan}], "s": "null"})
    assert result["ranges"] == [1.0, math.inf, -math.inf]
    assert result["max"] == math.inf
    assert math.isnan(result["deep"][0]["x"])


def test_a_text_that_says_infinity_stays_a_text() -> None:
    assert through({"data": "Infinity"}, STRING) == {"data": "Infinity"}
    assert through({"data": "to Infinity"}) == {"data": "to Infinity"}


def test_numpy_arrays_and_scalars_are_lists_and_numbers() -> None:
    value = {
        "ranges": np.array([1.5, np.inf], np.float32),
        "angle": np.float32(0.5),
        "n": np.int64(3),
        "m": np.eye(2),
        "b": np.bool_(True),
    }
    assert through(value) == {"ranges": [1.5, math.inf], "angle": 0.5, "n": 3, "m": [[1, 0], [0, 1]], "b": True}


def test_bytes_travel_as_blobs_wherever_they_are() -> None:
    value = {"data": b"\0\1", "parts": [{"x": bytearray(b"2")}, {"x": memoryview(b"3")}], "many": [b"4", b""]}
    text, blobs = encode_message("tag", "a/B", "nil", value)
    assert len(blobs) == 5
    assert set(json.loads(text)["data"]["msg"]) == {"data*", "parts", "many*"}
    assert through(value) == {"data": b"\0\1", "parts": [{"x": b"2"}, {"x": b"3"}], "many": [b"4", b""]}
    assert through(b"whole") == b"whole"


@pytest.mark.parametrize("value", [object(), {"x": 2**70, "y": object()}, {1, object()}, {"a": [[b"x"]]}])
def test_what_has_no_json_is_refused(value: object) -> None:
    with pytest.raises(InvalidRequest):
        encode_message("tag", "a/B", "nil", {"x": value})


def test_nesting_without_end_is_refused() -> None:
    value: list[Any] = []
    value.append(value)
    with pytest.raises(InvalidRequest):
        encode(value)


async def test_blobs_inside_a_message_reach_the_other_robot(fake: FakePlatform) -> None:
    async with Robot(fake.url, user="testUser", robot="a", password="testUser") as a:
        said = await a.publisher("said", "sensor_msgs/PointCloud2")
        heard = await a.subscriber("heard", "sensor_msgs/PointCloud2", to="a/said")
        cloud = {"width": 2, "data": bytes(1_000_000), "fields": [{"name": "x", "extra": b"blob"}]}
        await said.publish(cloud)
        assert await heard.get(10) == cloud
