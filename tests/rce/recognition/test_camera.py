"""The camera."""

from __future__ import annotations

import numpy as np
import pytest

from rce.recognition.camera import Camera, grey, project
from tests.support.plane_scenes import CAMERA, texture


def test_points_are_projected_with_their_derivatives() -> None:
    pixels, derivatives = project(np.array([[0.0, 0.0, 0.0]]), np.zeros(3), np.array([0.1, 0.2, 2.0]), CAMERA)
    assert pixels[0] == pytest.approx((349.5, 299.5))
    moved, _ = project(np.array([[0.0, 0.0, 0.0]]), np.zeros(3), np.array([0.1, 0.2, 2.001]), CAMERA)
    assert derivatives[:, 5] * 0.001 == pytest.approx((moved - pixels)[0], rel=1e-2)


def test_distortion_is_removed() -> None:
    picture = texture(0, 640, 480)
    assert CAMERA.rectify(picture) is picture
    bent = Camera(CAMERA.matrix, (-0.3, 0.1, 0.0, 0.0, 0.0))
    assert not np.array_equal(bent.rectify(picture), picture)
    assert abs(int(bent.rectify(picture)[240, 320]) - int(picture[240, 320])) < 60, "the centre stays"


def test_colours_become_grey() -> None:
    assert grey(np.full((2, 3, 3), 200, np.uint8)).tolist() == [[200] * 3] * 2
