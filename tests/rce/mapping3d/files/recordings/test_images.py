from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping3d.camera import Camera
from rce.mapping3d.evaluation.room import QVGA, look, render
from rce.mapping3d.files.recordings.images import ColorCamera, Undistortion, edge_agreement, read_color, read_depth
from rce.mapping3d.frames import RgbdFrame
from rce.mapping3d.poses import make_pose

POSE = look((3.0, 3.0, 1.5), (1.5, 1.0, 0.7))


def test_depth_image_of_eight_bits_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "d.png"
    cv2.imwrite(str(path), np.zeros((4, 4), np.uint8))
    with pytest.raises(InvalidRequest, match="16 bits"):
        read_depth(path, 1000.0)


@pytest.mark.parametrize("content", [b"", b"text"])
def test_file_that_is_no_image_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "c.png").write_bytes(content)
    with pytest.raises(InvalidRequest, match=r"c\.png is not an image"):
        read_color(tmp_path / "c.png")
    with pytest.raises(InvalidRequest, match="cannot be read"):
        read_color(tmp_path / "none.png")


def test_colours_of_a_camera_beside_are_registered_to_the_depths() -> None:
    own, depth = render(POSE, QVGA)
    beside = ColorCamera(Camera(320, 240, 230.0, 230.0, 158.0, 118.0), 0.05)
    seen, _ = render(POSE @ make_pose(np.eye(3), (0.05, 0.0, 0.0)), beside.camera)
    frame = RgbdFrame(0.0, seen, depth)
    registered = beside.registered(frame, QVGA)
    before, after = (np.abs(each.color.astype(float) - own).mean() for each in (frame, registered))
    assert after < 0.35 * before
    assert edge_agreement(registered) > edge_agreement(frame)


def test_distortion_of_the_lens_is_removed() -> None:
    color = np.zeros((240, 320, 3), np.uint8)
    coefficients = (-0.2, 0.05, 0.0, 0.0, 0.0)
    ray = np.array([[[0.4, 0.3, 1.0]]])
    (u, v), *_ = cv2.projectPoints(ray, np.zeros(3), np.zeros(3), QVGA.matrix, np.array(coefficients))[0].reshape(-1, 2)
    cv2.circle(color, (round(u), round(v)), 3, (255, 255, 255), -1)
    frame = Undistortion(QVGA, coefficients)(RgbdFrame(0.0, color, np.ones((240, 320), np.float32)))
    rows, columns = np.nonzero(frame.color[:, :, 0] > 128)
    expected = QVGA.project(ray[0])[0]
    np.testing.assert_allclose((columns.mean(), rows.mean()), expected, atol=1.0)
