"""JSON as rosbridge reads and writes it."""

from __future__ import annotations

import json
import time
from typing import Any

import pytest

from converters import TypeRegistry, Wire
from rce.errors import ConversionError
from rce.protocol.names import parse_type


def there_and_back(type_name: str, value: Any) -> Any:
    codec = TypeRegistry().message(parse_type(type_name), dialect="rosbridge")
    return json.loads(bytes(codec.decode(codec.encode(Wire(False, json.dumps(value).encode(), {}))).raw))


def test_non_finite_numbers_are_null() -> None:
    assert there_and_back("sensor_msgs/LaserScan", {"ranges": [1, None, "Infinity"]})["ranges"] == [1, None, None]
    assert there_and_back("std_msgs/Float64", {"data": float("nan")}) == {"data": None}


def test_images_are_plain_messages() -> None:
    assert there_and_back("sensor_msgs/Image", {"width": 1, "data": "AAEC"})["data"] == "AAEC"


@pytest.mark.parametrize("header", [None, {}, {"frame_id": "map"}])
def test_stamp_that_is_left_out_is_the_present_time(header: Any) -> None:
    before = int(time.time())
    value = {} if header is None else {"header": header}
    stamp = there_and_back("geometry_msgs/PoseStamped", value)["header"]["stamp"]
    assert before <= stamp["sec"] <= time.time()


def test_stamp_that_is_given_is_kept() -> None:
    assert there_and_back("std_msgs/Header", {"stamp": {"sec": 0, "nanosec": 0}})["stamp"] == {"sec": 0, "nanosec": 0}


def test_each_message_has_its_own_stamp() -> None:
    codec = TypeRegistry().message(parse_type("std_msgs/Header"), dialect="rosbridge")
    first, second = (bytes(codec.encode(Wire(False, b"{}", {}))) for _ in range(2))
    assert first != second


def test_names_of_ros_1_are_accepted() -> None:
    header = there_and_back("std_msgs/Header", {"seq": 3, "stamp": {"secs": 1, "nsecs": 2}, "frame_id": "a"})
    assert header == {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "a"}


def test_now_is_a_time() -> None:
    assert there_and_back("std_msgs/Header", {"stamp": "now"})["stamp"]["sec"] > 1_700_000_000


def test_field_at_fault_is_named() -> None:
    with pytest.raises(ConversionError, match=r"linear\.y"):
        there_and_back("geometry_msgs/Twist", {"linear": {"y": "fast"}})
