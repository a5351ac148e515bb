from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rce.mapping3d.evaluation.room import QVGA, look, render
from rce.mapping3d.frames import RgbdFrame
from rce.mapping3d.odometry.alignment import Alignment, Prior, align
from rce.mapping3d.odometry.pyramid import image_pyramid, reference_pyramid
from rce.mapping3d.poses import angle, distance, inverse, make_pose

FIRST = look((3.0, 3.0, 1.5), (1.5, 1.0, 0.7))
MOTION = make_pose(Rotation.from_rotvec((0.02, -0.04, 0.03)).as_matrix(), (0.05, -0.02, 0.03))
COLOR, DEPTH = render(FIRST, QVGA)
REFERENCE = reference_pyramid(image_pyramid(RgbdFrame(0.0, COLOR, DEPTH), QVGA))
SECOND_COLOR, SECOND_DEPTH = render(FIRST @ MOTION, QVGA)


def aligned(color: np.ndarray, depth: np.ndarray, prior: Prior | None = None) -> tuple[Alignment, float, float]:  # type: ignore[type-arg]
    found = align(REFERENCE, image_pyramid(RgbdFrame(0.1, color, depth), QVGA), np.eye(4), prior)
    error = found.pose @ MOTION
    return found, distance(error), angle(error)


def test_motion_of_5_centimetres_and_3_degrees_is_found() -> None:
    found, shift, turn = aligned(SECOND_COLOR, SECOND_DEPTH)
    assert shift < 0.002
    assert turn < 0.001
    assert found.fit > 0.9
    assert 0.8 < found.overlap < 1.0


def test_changed_exposure_does_not_matter() -> None:
    darker = (0.6 * SECOND_COLOR + 10).astype(np.uint8)
    _, shift, turn = aligned(darker, SECOND_DEPTH)
    assert shift < 0.002
    assert turn < 0.001


def test_colours_are_enough_where_the_image_has_no_depth() -> None:
    found, shift, turn = aligned(SECOND_COLOR, np.zeros_like(SECOND_DEPTH))
    assert shift < 0.01
    assert turn < 0.005
    assert found.measured == 0


def test_depths_are_enough_in_the_dark() -> None:
    _, shift, turn = aligned(np.zeros_like(SECOND_COLOR), SECOND_DEPTH)
    assert shift < 0.02
    assert turn < 0.01


def test_other_place_does_not_fit() -> None:
    color, depth = render(look((3.0, 2.5, 1.5), (5.5, 4.0, 1.0)), QVGA)
    assert aligned(color, depth)[0].fit < 0.5


def test_prior_decides_what_the_images_leave_open() -> None:
    # An even wall does not tell motion along it.
    gray, wall = np.full((240, 320, 3), 100, np.uint8), np.full((240, 320), 2.0, np.float32)
    levels = image_pyramid(RgbdFrame(0.0, gray, wall), QVGA)
    expected = make_pose(np.eye(3), (0.03, 0.0, 0.0))
    found = align(reference_pyramid(levels), levels, expected, Prior(expected, 1e4 * np.eye(6)))
    assert distance(found.pose @ inverse(expected)) == pytest.approx(0.0, abs=1e-3)
    assert found.information[0, 0] < 1e-3 * found.information[2, 2]
