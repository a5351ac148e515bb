from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping3d.evaluation.room import QVGA
from rce.mapping3d.files.recordings import open_recording
from rce.mapping3d.files.recordings.bags import color_image, depth_image
from tests.support.rgbd import BAGS, CLEAN, simulated

FRAMES = list(simulated(0.1, faults=CLEAN))


@pytest.mark.parametrize("kind", BAGS)
def test_bag_is_read(tmp_path: Path, kind: str) -> None:
    recording = open_recording(BAGS[kind](tmp_path, FRAMES))
    frames = list(recording)
    assert recording.camera == QVGA
    assert [frame.stamp for frame in frames] == pytest.approx([1.0 + frame.stamp for frame in FRAMES], abs=1e-6)
    np.testing.assert_array_equal(frames[2].color, FRAMES[2].color)
    np.testing.assert_allclose(frames[2].depth, FRAMES[2].depth, atol=1e-3)


def test_damaged_bag_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    with pytest.raises(InvalidRequest, match=r"a\.bag cannot be read") as caught:
        open_recording(path)
    assert str(tmp_path) not in str(caught.value)


def test_bag_without_images_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="no topic with depth"):
        open_recording(BAGS["ros1"](tmp_path, []))


def image(encoding: str, pixels: np.ndarray, padding: int = 0, big: int = 0) -> SimpleNamespace:  # type: ignore[type-arg]
    height, width = pixels.shape[:2]
    rows = np.frombuffer(pixels.tobytes(), np.uint8).reshape(height, -1)
    data = np.pad(rows, ((0, 0), (0, padding))).ravel()
    step = rows.shape[1] + padding
    return SimpleNamespace(encoding=encoding, height=height, width=width, step=step, data=data, is_bigendian=big)


def test_padded_rows_and_other_byte_orders_are_read() -> None:
    depth = np.array([[1000, 2000], [0, 65535]], np.uint16)
    expected = [[1.0, 2.0], [0.0, 0.0]]
    assert depth_image(image("16UC1", depth, padding=6), 1000.0).tolist() == expected
    assert depth_image(image("16UC1", depth.astype(">u2"), big=1), 1000.0).tolist() == expected
    metres = np.array([[1.0, np.nan]], np.float32)
    assert depth_image(image("32FC1", metres), 1000.0).tolist() == [[1.0, 0.0]]


def test_compressed_images_are_read() -> None:
    depth = np.array([[1000, 2000]], np.uint16)
    data = np.frombuffer(bytes(12) + cv2.imencode(".png", depth)[1].tobytes(), np.uint8)
    message = SimpleNamespace(format="16UC1; compressedDepth png", data=data)
    assert depth_image(message, 1000.0).tolist() == [[1.0, 2.0]]
    red = np.full((8, 8, 3), (0, 0, 255), np.uint8)
    png = np.frombuffer(cv2.imencode(".png", red)[1].tobytes(), np.uint8)
    assert color_image(SimpleNamespace(format="bgr8; png", data=png))[0, 0].tolist() == [255, 0, 0]


def test_unknown_encodings_and_short_images_are_refused() -> None:
    pixels = np.zeros((2, 2), np.uint8)
    with pytest.raises(InvalidRequest, match="bayer_rggb8"):
        color_image(image("bayer_rggb8", pixels))
    with pytest.raises(InvalidRequest, match="unknown"):
        depth_image(image("8UC1", pixels), 1000.0)
    with pytest.raises(InvalidRequest, match="fewer bytes"):
        depth_image(image("16UC1", pixels), 1000.0)
    with pytest.raises(InvalidRequest, match="rvl"):
        depth_image(SimpleNamespace(format="16UC1; compressedDepth rvl", data=np.zeros(20, np.uint8)), 1000.0)
