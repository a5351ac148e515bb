"""Tests of the payloads of the benchmark."""

from __future__ import annotations

import itertools
from typing import Any

import pytest
from rosbags.typesys import Stores, get_typestore

from rce.bench import payloads
from rce.errors import InvalidRequest

store = get_typestore(Stores.ROS2_KILTED)


def test_sizes_are_log_uniform_with_both_ends() -> None:
    assert payloads.sizes(7) == [10, 100, 1_000, 10_000, 100_000, 1_000_000, 10_000_000]
    sizes = payloads.sizes(25)
    assert (len(sizes), sizes[0], sizes[-1]) == (25, 10, 10_000_000)
    assert all(1.7 < b / a < 1.9 for a, b in itertools.pairwise(sizes))


@pytest.mark.parametrize("count", [0, 1, -3])
def test_fewer_than_two_sizes_are_rejected(count: int) -> None:
    with pytest.raises(InvalidRequest):
        payloads.sizes(count)


@pytest.mark.parametrize("size", [10, 11, 12, 13])
def test_cdr_is_deserialised_by_ros_types(size: int) -> None:
    text: Any = store.deserialize_cdr(payloads.string_cdr(size), "std_msgs/msg/String")
    assert text.data == "x" * size
    data: Any = store.deserialize_cdr(payloads.bytes_cdr(size), "std_msgs/msg/UInt8MultiArray")
    assert (bytes(data.data), data.layout.dim, data.layout.data_offset) == (bytes(size), [], 0)


def test_image_is_deserialised_by_ros_types() -> None:
    image: Any = store.deserialize_cdr(payloads.image_cdr(payloads.IMAGE), "sensor_msgs/msg/Image")
    assert (image.height, image.width, image.step, image.encoding) == (480, 640, 1920, "rgb8")
    assert (len(image.data), image.is_bigendian, image.header.frame_id) == (921_600, 0, "")
    form = payloads.image_json(payloads.IMAGE)
    assert (form["height"], form["width"], form["step"]) == (480, 640, 1920)
    assert len(payloads.IMAGES[1].read(form)) == 921_600
