from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rce.mapping3d.dense.rasteriser import draw_triangles


def drawn(corners: list[list[float]], triangles: list[list[int]]) -> NDArray[np.float32]:
    image, nearest = np.zeros((10, 10, 3), np.float32), np.full((10, 10), np.inf, np.float32)
    colors = np.repeat(np.arange(1, len(corners) // 3 + 1), 3)[:, None] * np.ones((1, 3))
    draw_triangles(image, nearest, np.array(corners), colors.astype(np.float32), np.array(triangles, np.int32))
    return image


FAR = [[0.0, 0.0, 5.0], [0.0, 9.0, 5.0], [9.0, 0.0, 5.0]]
NEAR = [[0.0, 0.0, 2.0], [0.0, 4.0, 2.0], [4.0, 0.0, 2.0]]


def test_triangle_is_filled() -> None:
    image = drawn(FAR, [[0, 1, 2]])
    assert image[1, 1].tolist() == [1, 1, 1]
    assert image[8, 8].tolist() == [0, 0, 0]


def test_triangle_from_behind_is_left_out() -> None:
    assert not drawn(FAR, [[0, 2, 1]]).any()


def test_nearer_triangle_hides_the_other_in_any_order() -> None:
    for order in ([[0, 1, 2], [3, 4, 5]], [[3, 4, 5], [0, 1, 2]]):
        image = drawn(FAR + NEAR, order)
        assert (image[1, 1, 0], image[5, 1, 0]) == (2, 1)


def test_triangle_outside_the_image_is_cut() -> None:
    assert drawn([[-50.0, -50.0, 1.0], [-50.0, 60.0, 1.0], [60.0, -50.0, 1.0]], [[0, 1, 2]]).any()
