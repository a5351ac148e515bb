from __future__ import annotations

import numpy as np

from rce.mapping3d.camera import Camera
from rce.mapping3d.frames import RgbdFrame, reduced, reduced_camera


def halved_depth(*rows: list[float]) -> list[list[float]]:
    depth = np.array(rows, np.float32)
    frame = RgbdFrame(0.0, np.zeros((*depth.shape, 3), np.uint8), depth)
    return np.round(frame.halved().depth, 4).tolist()  # type: ignore[no-any-return]


def test_halved_depth_is_the_mean_of_four_pixels() -> None:
    assert np.allclose(halved_depth([1.0, 1.01], [1.01, 1.02]), [[1.01]])


def test_halved_depth_ignores_pixels_without_depth() -> None:
    assert halved_depth([0.0, 2.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]) == [[2.0, 0.0]]


def test_halved_depth_at_an_edge_is_that_of_the_nearer_surface() -> None:
    assert halved_depth([1.0, 3.0], [1.0, 3.0]) == [[1.0]]


def test_halved_colour_is_the_mean_of_four_pixels() -> None:
    color = np.zeros((2, 2, 3), np.uint8)
    color[0] = 100
    assert RgbdFrame(0.0, color, np.zeros((2, 2), np.float32)).halved().color.tolist() == [[[50, 50, 50]]]


def test_large_images_are_reduced_to_qvga() -> None:
    frame = RgbdFrame(0.0, np.zeros((480, 640, 3), np.uint8), np.ones((480, 640), np.float32))
    assert reduced(frame).depth.shape == (240, 320)
    assert reduced_camera(Camera(640, 480, 500.0, 500.0, 320.0, 240.0)).width == 320
