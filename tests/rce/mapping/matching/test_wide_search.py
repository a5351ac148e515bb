from __future__ import annotations

import math

import numpy as np
import pytest

from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.grid import GridMap, OccupancyGrid
from rce.mapping.matching.fields import Field, square_around
from rce.mapping.matching.wide_search import match_wide
from tests.support.laser import PLACE, SENSOR, points_at


def seen(points: Points) -> tuple[Field, OccupancyGrid]:
    """Return walls and free space of points that were seen five times from the origin."""
    field, grid = square_around(ORIGIN, 20.0, 0.05), GridMap(0.1)
    for _ in range(5):
        field.add(points)
        grid.insert(SENSOR, points)
    return field, grid.render()


def sides(low: float, high: float) -> Points:
    """Return both walls of a corridor along x."""
    x = np.arange(low, high, 0.05)
    return np.concatenate([np.stack([x, np.full(len(x), side)], axis=1) for side in (-1.0, 1.0)])


@pytest.mark.parametrize("motion", [ORIGIN, Pose(0.7, 0.2, 1.2), Pose(1.2, -0.6, -0.9)], ids=str)
def test_unknown_motion_is_found(motion: Pose) -> None:
    field, free = seen(points_at(PLACE))
    found = match_wide(field, free, points_at(PLACE @ motion), [ORIGIN])
    error = motion.to(found.pose)
    assert math.hypot(error.x, error.y) < 0.05
    assert abs(error.theta) < 0.01
    assert found.unambiguous


def test_match_in_a_uniform_corridor_is_ambiguous_and_keeps_the_prediction() -> None:
    field, free = seen(sides(-15.0, 15.0))
    found = match_wide(field, free, sides(-8.0, 8.0), [Pose(0.9, 0.0, 0.0), ORIGIN])
    assert not found.unambiguous
    assert found.pose.x == pytest.approx(0.9, abs=0.2)
    assert found.covariance[0, 0] > 0.25 > 25 * found.covariance[1, 1]


def test_free_space_contradicts_a_wall() -> None:
    """The end of a corridor is nearer than before. The side walls alone would fit best where the robot was."""
    end = np.stack([np.full(80, 6.0), np.linspace(-1.0, 1.0, 80)], axis=1)
    field, free = seen(np.concatenate([sides(-6.0, 6.0), end]))
    found = match_wide(field, free, np.concatenate([sides(-5.0, 3.0), end - np.array([3.0, 0.0])]), [ORIGIN])
    assert found.pose.x == pytest.approx(3.0, abs=0.05)
