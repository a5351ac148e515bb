from __future__ import annotations

import math

import numpy as np

from rce.mapping3d.camera import Camera
from rce.mapping3d.dense.kept_frames import KeptFrame, apart
from rce.mapping3d.poses import transform
from tests.support.rooms import ROOM, looking, view

POSE = looking(-0.5, 0.0, 1.3, 150.0, 10.0)


def test_images_are_the_same_at_each_call() -> None:
    kept = KeptFrame(view(POSE), POSE, 5.0)
    first, second = kept.images(), kept.images()
    assert (first[0] == second[0]).all()
    assert (first[1] == second[1]).all()
    assert np.abs(first[0] - view(POSE).frame.depth)[first[0] > 0].max() < 0.00051


def test_large_images_are_reduced_and_see_the_same_points() -> None:
    kept = KeptFrame(view(POSE, camera=Camera(640, 480, 560.0, 560.0, 319.5, 239.5)), POSE, 5.0)
    depth, color = kept.images()
    assert depth.shape == color.shape[:2] == (240, 320)
    points = transform(POSE, kept.camera.points(depth).reshape(-1, 3)[depth.reshape(-1) > 0])
    outside = np.maximum(ROOM[0] - points, points - ROOM[1]).max(axis=1)
    assert np.abs(outside).max() < 0.002  # all of them are on a wall


def test_offset_counts_what_a_turn_moves() -> None:
    turned = POSE @ looking(0, 0, 0, 0) @ np.linalg.inv(looking(0, 0, 0, 1.0))
    assert abs(apart(POSE, turned) - 2 * math.radians(1.0)) < 1e-6
    assert apart(POSE, POSE) < 1e-6
