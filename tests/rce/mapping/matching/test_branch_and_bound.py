from __future__ import annotations

import math

import numpy as np

from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.matching import branch_and_bound, kernels
from rce.mapping.matching.fields import Field, square_around
from rce.mapping.pose_graph.loops import SEARCH
from tests.support.laser import PLACE, points_at

STEPS, TURNS, TURN, BUDGET = 20, 10, math.radians(1), 100_000


def room() -> Field:
    field = square_around(ORIGIN, 20.0, 0.1)
    field.add(points_at(PLACE))
    return field


def test_result_is_that_of_exhaustive_search() -> None:
    field, cells = room(), points_at(PLACE @ Pose(0.7, -0.9, 0.1)) / 0.1
    centre = field.pose_to_cells(ORIGIN)
    found = branch_and_bound.branch_and_bound(
        field.pyramid(5), cells, *centre, STEPS, TURNS, TURN, 0.2, branch_and_bound.NOTHING_EXCLUDED, BUDGET
    )
    exhaustive = kernels.correlate(field.likelihood, cells, *centre, 1, STEPS, TURNS, TURN, 0.0, 0.0)
    np.testing.assert_allclose(found, exhaustive)
    pose = field.pose_from_cells(Pose(*found[:3]))
    np.testing.assert_allclose(pose, (0.7, -0.9, 0.1), atol=0.06)


def test_no_pose_is_found_below_the_required_score() -> None:
    field, cells = room(), np.random.default_rng(0).uniform(-50.0, 50.0, (200, 2))
    centre = field.pose_to_cells(ORIGIN)
    found = branch_and_bound.branch_and_bound(
        field.pyramid(5), cells, *centre, STEPS, TURNS, TURN, 0.7, branch_and_bound.NOTHING_EXCLUDED, BUDGET
    )
    assert found[3] == 0.7


def test_excluded_pose_is_not_found() -> None:
    field, cells = room(), points_at(PLACE) / 0.1
    centre = field.pose_to_cells(ORIGIN)
    excluded = np.array([*centre, 4.0, 0.2])
    found = branch_and_bound.branch_and_bound(
        field.pyramid(5), cells, *centre, STEPS, TURNS, TURN, 0.0, excluded, BUDGET
    )
    assert max(abs(found[0] - centre.x), abs(found[1] - centre.y)) >= 4.0
    assert 0.0 < found[3] < 0.8


def test_budget_ends_the_search() -> None:
    field, cells = room(), points_at(PLACE) / 0.1
    centre = field.pose_to_cells(ORIGIN)
    found = branch_and_bound.branch_and_bound(
        field.pyramid(5), cells, *centre, STEPS, TURNS, TURN, 0.0, branch_and_bound.NOTHING_EXCLUDED, 10
    )
    assert found[3] == -1.0


def test_unambiguous_place_is_found() -> None:
    field, cells = room(), points_at(PLACE @ Pose(0.7, -0.9, 0.1)) / SEARCH.resolution
    found = branch_and_bound.find_place(field.pyramid(5), cells, field.pose_to_cells(ORIGIN), STEPS, TURNS, SEARCH)
    assert found is not None
    np.testing.assert_allclose(field.pose_from_cells(found), (0.7, -0.9, 0.1), atol=0.06)


def test_place_in_a_uniform_corridor_is_ambiguous() -> None:
    x = np.arange(-15.0, 15.0, 0.05)
    walls = np.concatenate([np.stack([x, np.full(len(x), side)], axis=1) for side in (-1.0, 1.0)])
    field, cells = square_around(ORIGIN, 20.0, SEARCH.resolution), walls[np.abs(walls[:, 0]) < 8.0] / SEARCH.resolution
    field.add(walls)
    centre = field.pose_to_cells(ORIGIN)
    assert branch_and_bound.find_place(field.pyramid(5), cells, centre, STEPS, TURNS, SEARCH) is None
