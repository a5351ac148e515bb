from __future__ import annotations

import math

import numpy as np

from rce.mapping.clouds import Sweep
from rce.mapping.scan_cutting import Band, cut_scan


def test_scan_has_the_nearest_point_of_each_direction_within_the_band() -> None:
    points = np.array([[2, 0, 0.1], [3, 0, 0], [0, 4, -0.2], [0, -1, 0.5], [0.1, 0, 0]], np.float32)
    scan = cut_scan(Sweep(7.0, points, np.zeros(5)), Band(-0.3, 0.3))
    assert scan.stamp == 7.0
    np.testing.assert_allclose(sorted(scan.points(50.0).tolist()), [[0, 4], [2, 0]], atol=0.02)
    assert np.isfinite(scan.ranges).sum() == 2, "what is above the band, or too near, is left out"


def test_beam_points_to_its_points() -> None:
    around = np.linspace(-math.pi, math.pi, 100, endpoint=False)
    points = np.stack([5 * np.cos(around), 5 * np.sin(around), np.zeros(100)], axis=1).astype(np.float32)
    found = cut_scan(Sweep(0.0, points, np.zeros(100))).points(50.0)
    assert len(found) == 100
    away = np.linalg.norm(found[:, None] - points[None, :, :2], axis=2).min(axis=1)
    assert away.max() < 5 * math.pi / 720


def test_sweep_without_points_is_a_scan_without_returns() -> None:
    assert not len(cut_scan(Sweep(0.0, np.empty((0, 3), np.float32), np.empty(0))).points(50.0))
