from __future__ import annotations

import itertools

import numpy as np
import pytest

from rce.mapping3d.evaluation.building import BOXES, ROUND, Pattern, SimulatedSweeps, patrol, solid_state, spinning
from rce.mapping3d.poses import Floats, distance, inverse, transform


def away_from_surfaces(points: Floats) -> Floats:
    """Return the distance (n,) of points to the nearest face of a box."""
    nearest = np.full(len(points), np.inf)
    for box in BOXES:
        low, high = box[:3], box[3:]
        outside = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0), axis=1)
        inside = np.minimum(points - low, high - points).min(axis=1)
        nearest = np.minimum(nearest, np.where(outside > 0, outside, np.maximum(inside, 0)))
    return nearest


@pytest.mark.parametrize("pattern", [spinning(8, 90), solid_state(600)], ids=lambda each: each.name)
def test_standing_lidar_sees_the_surfaces_of_the_building(pattern: Pattern) -> None:
    _, pose = patrol(ROUND, 0.0, begin=5.0)[0]
    (sweep,) = SimulatedSweeps("", ((0.0, pose), (0.1, pose)), pattern, noise=0.0)
    assert len(sweep.points) > 500
    assert away_from_surfaces(transform(pose, sweep.points)).max() < 1e-3


def test_moving_lidar_distorts_its_sweep() -> None:
    way = patrol(ROUND, 3.0)
    *_, sweep = SimulatedSweeps("", way, spinning(8, 90), noise=0.0)
    begin, end = way[-2][1], way[-1][1]
    off = away_from_surfaces(transform(begin, sweep.points))
    assert off[sweep.times < 0.01].max() < 0.03
    assert off.max() > 0.5 * distance(inverse(begin) @ end)


def test_robot_starts_from_rest() -> None:
    way = patrol(ROUND, 3.0)
    steps = [distance(inverse(first) @ second) for (_, first), (_, second) in itertools.pairwise(way)]
    assert steps[0] < 0.03 < 0.07 < steps[-1]
    assert len(way) == 31
