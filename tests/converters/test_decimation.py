"""Decimation of scans, images and clouds."""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from converters import TypeRegistry, Wire
from converters.decimation import Decimator
from rce.errors import ConversionError, InvalidRequest
from rce.protocol.names import parse_type

REGISTRY = TypeRegistry()


def decimated(type: str, value: dict[str, Any], **options: Any) -> dict[str, Any]:
    codec = REGISTRY.message(parse_type(type), "json")
    smaller = Decimator(codec.message, **options)(codec.encode(Wire(False, json.dumps(value).encode(), {})))
    found: dict[str, Any] = json.loads(bytes(codec.decode(smaller).raw))
    return found


def image(pixels: NDArray[Any], encoding: str, padding: int = 0) -> dict[str, Any]:
    rows = pixels.reshape(pixels.shape[0], -1).view(np.uint8)
    data = np.pad(rows, ((0, 0), (0, padding))).tobytes()
    return {"header": {"frame_id": "cam"}, "height": pixels.shape[0], "width": pixels.shape[1], "encoding": encoding,
            "step": rows.shape[1] + padding, "data": base64.b64encode(data).decode()}  # fmt: skip


def pixels_of(message: dict[str, Any], dtype: Any = np.uint8) -> NDArray[Any]:
    data = np.frombuffer(base64.b64decode(message["data"]), np.uint8)
    assert len(data) == message["step"] * message["height"]
    pixels: NDArray[Any] = data.view(dtype).reshape(message["height"], message["width"], -1)
    return pixels


def test_every_nth_beam_of_a_scan_keeps_its_angle() -> None:
    scan = {"angle_min": -1.0, "angle_max": 1.0, "angle_increment": 0.5, "time_increment": 0.25,
            "ranges": [0.0, 1.0, "NaN", 3.0, "Infinity"], "intensities": []}  # fmt: skip
    got = decimated("sensor_msgs/LaserScan", scan, step=2)
    assert got["ranges"] == [0.0, "NaN", "Infinity"]
    assert (got["angle_increment"], got["angle_max"], got["time_increment"]) == (1.0, 1.0, 0.5)


def test_every_nth_row_and_column_of_an_image_is_kept_without_padding() -> None:
    pixels = np.arange(5 * 7 * 3, dtype=np.uint8).reshape(5, 7, 3)
    got = decimated("sensor_msgs/Image", image(pixels, "rgb8", padding=4), step=2)
    assert np.array_equal(pixels_of(got), pixels[::2, ::2])
    assert got["header"]["frame_id"] == "cam"


def test_image_is_scaled_into_a_size_and_never_enlarged() -> None:
    pixels = np.full((480, 640, 3), 77, np.uint8)
    got = decimated("sensor_msgs/Image", image(pixels, "bgr8"), size=(320, 320))
    assert (got["width"], got["height"]) == (320, 240)
    assert (pixels_of(got) == 77).all()
    assert decimated("sensor_msgs/Image", image(pixels, "bgr8"), size=(2000, 2000))["width"] == 640


def test_depth_is_scaled_without_averages() -> None:
    depth = np.where(np.arange(64 * 64).reshape(64, 64) % 2, 1000, 3000).astype(np.uint16)
    got = decimated("sensor_msgs/Image", image(depth, "16UC1"), size=(22, 22))
    assert set(np.unique(pixels_of(got, "<u2"))) <= {1000, 3000}


@pytest.mark.parametrize(("height", "kept"), [(1, 4), (2, 4)])
def test_every_nth_point_of_a_cloud_is_kept_and_rows_stay_rows(height: int, kept: int) -> None:
    width = 10 if height == 1 else 12
    points = np.arange(height * width * 4, dtype=np.float32).reshape(height, width, 4)
    cloud = {"height": height, "width": width, "point_step": 16, "row_step": 16 * width,
             "data": base64.b64encode(points.tobytes()).decode()}  # fmt: skip
    got = decimated("sensor_msgs/PointCloud2", cloud, step=3)
    assert (got["height"], got["width"], got["row_step"]) == (1, kept, 16 * kept)
    data = np.frombuffer(base64.b64decode(got["data"]), np.float32).reshape(1, kept, 4)
    assert np.array_equal(data, points[::3, ::3] if height > 1 else points[:, ::3])


def test_empty_cloud_stays_empty() -> None:
    assert decimated("sensor_msgs/PointCloud2", {"point_step": 16}, step=3)["data"] == ""


def test_types_without_parts_are_refused() -> None:
    with pytest.raises(InvalidRequest, match="std_msgs/msg/String cannot be decimated: sensor_msgs/msg/Image, "):
        Decimator(REGISTRY.message(parse_type("std_msgs/String")).message, 2)
    with pytest.raises(InvalidRequest, match="use step"):
        Decimator(REGISTRY.message(parse_type("sensor_msgs/LaserScan")).message, size=(2, 2))


def test_images_that_do_not_fit_are_refused() -> None:
    pixels = np.zeros((2, 2), np.uint8)
    with pytest.raises(ConversionError, match="'bayer_rggb8' cannot be decimated"):
        decimated("sensor_msgs/Image", image(pixels, "bayer_rggb8"), step=2)
    with pytest.raises(ConversionError, match="4 bytes in rows of 2 are not 2 x 2 of 3 bytes"):
        decimated("sensor_msgs/Image", image(pixels, "rgb8"), step=2)
    with pytest.raises(ConversionError, match="little-endian"):
        Decimator(REGISTRY.message(parse_type("sensor_msgs/Image")).message, 2)(b"\0\0\0\0")
