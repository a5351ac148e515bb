from __future__ import annotations

import numpy as np

from rce.mapping3d.evaluation.room import QVGA, render, sweep
from rce.mapping3d.frames import RgbdFrame
from rce.mapping3d.odometry.pyramid import FULL_POINTS, LEVELS, image_pyramid, reference_pyramid

FRAME = RgbdFrame(0.0, *render(sweep(0.1)[0][1], QVGA))


def test_each_size_is_half_of_the_one_before() -> None:
    levels = image_pyramid(FRAME, QVGA)
    assert [level.image.shape for level in levels] == [(240 >> k, 320 >> k) for k in range(LEVELS)]
    assert [level.depth.shape for level in levels] == [(240 >> k, 320 >> k) for k in range(LEVELS)]


def test_depths_are_not_mixed_across_edges() -> None:
    depth = np.ones((240, 320), np.float32)
    depth[:, 161:] = 3.0
    half = image_pyramid(RgbdFrame(0.0, FRAME.color, depth), QVGA)[1]
    assert set(np.unique(half.depth)) == {1.0, 3.0}


def test_reference_has_points_where_something_can_be_measured() -> None:
    depth = FRAME.depth.copy()
    depth[:120] = 0.0
    levels = image_pyramid(RgbdFrame(0.0, FRAME.color, depth), QVGA)
    reference = reference_pyramid(levels)
    assert 1000 < len(reference[0].points) <= FULL_POINTS
    assert (QVGA.project(reference[0].points)[:, 1] > 119).all()


def test_even_wall_counts_by_its_depth_only() -> None:
    gray = np.full((240, 320, 3), 100, np.uint8)
    reference = reference_pyramid(image_pyramid(RgbdFrame(0.0, gray, np.full((240, 320), 2.0, np.float32)), QVGA))
    assert (reference[0].brightness == -1).all()
    assert reference[0].normals.any(axis=1).all()
