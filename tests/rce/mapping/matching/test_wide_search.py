from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.grid import GridMap, OccupancyGrid
from rce.mapping.matching.fields import Field, square_around
from rce.mapping.matching.scan_matching import Match
from rce.mapping.matching.wide_search import passes_wall, search_wide
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


def search(
    field: Field,
    free: OccupancyGrid,
    points: Points,
    predictions: list[Pose],
    step_cost: Callable[[Pose], float] = lambda pose: 0.0,
) -> list[Match]:
    return [candidate.match for candidate in search_wide(field, free, points, predictions, step_cost)]


@pytest.mark.parametrize("motion", [ORIGIN, Pose(0.7, 0.2, 1.2), Pose(1.2, -0.6, -0.9)], ids=str)
def test_unknown_motion_is_found(motion: Pose) -> None:
    field, free = seen(points_at(PLACE))
    found, *_ = search(field, free, points_at(PLACE @ motion), [ORIGIN])
    error = motion.to(found.pose)
    assert math.hypot(error.x, error.y) < 0.05
    assert abs(error.theta) < 0.01
    assert found.unambiguous


def test_match_in_a_uniform_corridor_is_ambiguous_and_keeps_the_prediction() -> None:
    field, free = seen(sides(-15.0, 15.0))
    found, *others = search(field, free, sides(-8.0, 8.0), [Pose(0.9, 0.0, 0.0), ORIGIN])
    assert others
    assert not found.unambiguous
    assert found.pose.x == pytest.approx(0.9, abs=0.2)
    assert found.covariance[0, 0] > 0.25 > 25 * found.covariance[1, 1]


def test_free_space_contradicts_a_wall() -> None:
    """The end of a corridor is nearer than before. The side walls alone would fit best where the robot was."""
    end = np.stack([np.full(80, 6.0), np.linspace(-1.0, 1.0, 80)], axis=1)
    field, free = seen(np.concatenate([sides(-6.0, 6.0), end]))
    found, *_ = search(field, free, np.concatenate([sides(-5.0, 3.0), end - np.array([3.0, 0.0])]), [ORIGIN])
    assert found.pose.x == pytest.approx(3.0, abs=0.05)


def test_step_cost_decides_where_the_scan_fits_everywhere() -> None:
    field, free = seen(sides(-15.0, 15.0))
    found, *_ = search(field, free, sides(-8.0, 8.0), [ORIGIN], lambda pose: 0.2 * abs(abs(pose.x) - 2.0))
    assert abs(found.pose.x) == pytest.approx(2.0, abs=0.2)


def test_places_are_distinct_and_the_best_comes_first() -> None:
    field, free = seen(sides(-15.0, 15.0))
    found = search_wide(field, free, sides(-8.0, 8.0), [ORIGIN], lambda pose: 0.0)
    assert len(found) > 2
    values = [candidate.value for candidate in found]
    assert values == sorted(values, reverse=True)
    ordered = sorted(candidate.match.pose.x for candidate in found)
    assert np.diff(ordered).min() > 0.4


def test_beam_does_not_pass_a_wall() -> None:
    """A wall at 4 m is the far one if the robot has not moved, but then the beams would pass the near one."""
    near, far = (np.stack([np.full(80, x), np.linspace(-2.0, 2.0, 80)], axis=1) for x in (2.0, 5.0))
    field, grid = square_around(ORIGIN, 20.0, 0.05), GridMap(0.1)
    for _ in range(5):
        for points, sensor in ((far, 3.0), (near, 0.0)):
            field.add(points)
            grid.insert(np.array([[sensor, 0.0]]), points)
    at_four_metres = np.stack([np.full(80, 4.0), np.linspace(-2.0, 2.0, 80)], axis=1)
    found, *_ = search(field, grid.render(), at_four_metres, [Pose(1.0, 0.0, 0.0)])
    assert found.pose.x == pytest.approx(-2.0, abs=0.05)


@pytest.mark.parametrize(
    ("end", "passes"),
    [((9.5, 2.5), True), ((5.5, 2.5), False), ((6.5, 2.5), False), ((0.5, 2.5), False), ((40.0, 2.5), True)],
    ids=["beyond", "at the wall", "in the margin", "before", "outside of the grid"],
)
def test_wall_on_a_beam_is_found(end: tuple[float, float], passes: bool) -> None:
    cells = np.full((5, 12), -1, np.int8)
    cells[:, 5] = 90
    found = passes_wall(cells, np.array([1.5, 2.5]), np.array([end]), 2.0, 70)
    assert found.tolist() == [passes]
