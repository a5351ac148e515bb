from __future__ import annotations

import math

import numpy as np
import pytest

from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.matching.fields import Field, square_around
from rce.mapping.matching.local_map import SETTINGS
from rce.mapping.matching.scan_matching import match
from tests.support.laser import PLACE, points_at


@pytest.fixture(scope="module")
def field() -> Field:
    """Walls of the first room, in the frame of a robot at PLACE."""
    field = square_around(ORIGIN, 20.0, 0.05)
    for seed in range(5):
        field.add(points_at(PLACE, noise=0.01, seed=seed))
    return field


@pytest.mark.parametrize(
    "shift", [ORIGIN, Pose(0.03, -0.02, 0.01), Pose(0.4, -0.3, 0.3), Pose(-0.45, 0.45, -0.5)], ids=str
)
def test_known_shift_is_recovered(field: Field, shift: Pose) -> None:
    found = match(field, points_at(PLACE @ shift, noise=0.01, seed=9), [ORIGIN], SETTINGS.near)
    error = shift.to(found.pose)
    assert math.hypot(error.x, error.y) < 0.02
    assert abs(error.theta) < 0.005
    assert found.score > 0.6


def test_second_prediction_is_used_if_the_first_is_wrong(field: Field) -> None:
    shift = Pose(0.1, 0.1, 1.5)
    found = match(field, points_at(PLACE @ shift, noise=0.01, seed=9), [ORIGIN, Pose(0.0, 0.0, 1.4)], SETTINGS.near)
    assert abs(shift.to(found.pose).theta) < 0.01


def test_covariance_is_large_along_a_corridor() -> None:
    field = square_around(ORIGIN, 20.0, 0.05)
    x = np.linspace(-8.0, 8.0, 200)
    corridor = np.concatenate([np.stack([x, np.full(200, side)], axis=1) for side in (-1.0, 1.0)])
    for _ in range(5):
        field.add(corridor)
    inner = corridor[np.abs(corridor[:, 0]) < 4.0]
    found = match(field, inner, [Pose(0.03, 0.05, 0.01)], SETTINGS.near)
    assert np.linalg.eigvalsh(found.covariance).min() > 0
    assert found.covariance[0, 0] > 50 * found.covariance[1, 1]
    assert abs(found.pose.y) < 0.01
    assert abs(found.pose.x - 0.03) < 0.15, "along the corridor the prediction decides"
