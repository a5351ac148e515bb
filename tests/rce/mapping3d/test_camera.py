from __future__ import annotations

import numpy as np

from rce.mapping3d.camera import Camera

VGA = Camera(640, 480, 525.0, 520.0, 319.5, 239.5)


def test_points_of_a_depth_image_project_to_their_pixels() -> None:
    depth = np.random.default_rng(0).uniform(0.5, 4.0, (480, 640)).astype(np.float32)
    pixels = VGA.project(VGA.points(depth).reshape(-1, 3)).reshape(480, 640, 2)
    np.testing.assert_allclose(pixels[17, 401], (401, 17), atol=1e-3)
    np.testing.assert_allclose(pixels[479, 0], (0, 479), atol=1e-3)


def test_scaled_camera_sees_the_centre_of_the_image_in_the_same_direction() -> None:
    half = VGA.scaled(0.5)
    assert (half.width, half.height, half.fx, half.cx) == (320, 240, 262.5, 159.5)
    # The centre of pixel (10, 20) of the small image lies between pixels 20 and 21, 40 and 41 of the large one.
    expected = (VGA.rays()[40, 20] + VGA.rays()[41, 21]) / 2
    np.testing.assert_allclose(half.rays()[20, 10], expected, atol=1e-6)


def test_pixel_without_depth_has_no_point() -> None:
    assert not VGA.points(np.zeros((480, 640), np.float32)).any()


def test_point_behind_the_camera_has_no_pixel() -> None:
    assert np.isnan(VGA.project(np.array([[0.0, 0.0, -1.0]]))).all()
