"""Points of a scan."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rce.mapping.scans import Scan, beam_directions


def scan(ranges: list[float], angle_min: float = 0.0, increment: float = math.pi / 2, range_max: float = 10.0) -> Scan:
    return Scan(0.0, np.array(ranges, np.float32), angle_min, increment, range_max)


def test_beams_turn_to_the_left() -> None:
    points = scan([1.0, 2.0, 3.0]).points(100.0)
    np.testing.assert_allclose(points, [[1.0, 0.0], [0.0, 2.0], [-3.0, 0.0]], atol=1e-12)
    assert points.dtype == np.float64


def test_first_beam_points_to_the_smallest_angle() -> None:
    np.testing.assert_allclose(scan([2.0], -math.pi / 2).points(100.0), [[0.0, -2.0]], atol=1e-12)


@pytest.mark.parametrize("nothing", [math.nan, math.inf, -math.inf, 0.0, -1.0, 10.0, 10.5])
def test_beam_without_echo_has_no_point(nothing: float) -> None:
    np.testing.assert_allclose(scan([nothing, 9.9]).points(100.0), [[0.0, 9.9]], atol=1e-6)


@pytest.mark.parametrize(("limit", "count"), [(1.0, 0), (1.01, 1), (3.0, 2), (math.inf, 3)])
def test_points_beyond_the_limit_are_left_out(limit: float, count: int) -> None:
    assert len(scan([1.0, 2.0, 3.0]).points(limit)) == count


@pytest.mark.parametrize(("angle_min", "increment"), [(math.nan, 0.1), (0.0, math.inf), (math.inf, -math.inf)])
def test_scan_with_invalid_angles_has_no_points(angle_min: float, increment: float) -> None:
    assert scan([1.0, 2.0], angle_min, increment).points(10.0).shape == (0, 2)


def test_scan_without_beams_has_no_points() -> None:
    assert scan([]).points(10.0).shape == (0, 2)


def test_directions_have_unit_length() -> None:
    np.testing.assert_allclose(np.hypot(*beam_directions(360, -math.pi, 0.0175).T), 1.0)
