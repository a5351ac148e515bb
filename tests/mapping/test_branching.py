from __future__ import annotations

import math

import numpy as np

from rce.mapping import branching, kernels
from rce.mapping.fields import Field, square_around
from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.simulation.floor_plan import apartment

NOWHERE = np.zeros(5)
STEPS, TURNS, TURN, BUDGET = 20, 10, math.radians(1), 100_000
PLACE = Pose(2.6, 3.4, 0.3)


def seen_from(pose: Pose) -> Points:
    ranges = apartment().ranges(*pose, 240, 2 * math.pi)
    angles = -math.pi + np.arange(240) * 2 * math.pi / 240
    return np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=1)


def room() -> Field:
    field = square_around(ORIGIN, 20.0, 0.1)
    field.add(seen_from(PLACE))
    return field


def test_it_finds_what_exhaustive_search_finds() -> None:
    field, cells = room(), seen_from(PLACE @ Pose(0.7, -0.9, 0.1)) / 0.1
    centre = field.pose_to_cells(ORIGIN)
    found = branching.branch_and_bound(field.pyramid(5), cells, *centre, STEPS, TURNS, TURN, 0.2, NOWHERE, BUDGET)
    exhaustive = kernels.correlate(field.likelihood, cells, *centre, 1, STEPS, TURNS, TURN, 0.0, 0.0)
    np.testing.assert_allclose(found, exhaustive)
    pose = field.pose_from_cells(Pose(*found[:3]))
    np.testing.assert_allclose(pose, (0.7, -0.9, 0.1), atol=0.06)


def test_nothing_is_found_where_nothing_is_good_enough() -> None:
    field, cells = room(), np.random.default_rng(0).uniform(-50.0, 50.0, (200, 2))
    centre = field.pose_to_cells(ORIGIN)
    found = branching.branch_and_bound(field.pyramid(5), cells, *centre, STEPS, TURNS, TURN, 0.7, NOWHERE, BUDGET)
    assert found[3] == 0.7


def test_what_is_excluded_is_not_found() -> None:
    field, cells = room(), seen_from(PLACE) / 0.1
    centre = field.pose_to_cells(ORIGIN)
    excluded = np.array([*centre, 4.0, 0.2])
    found = branching.branch_and_bound(field.pyramid(5), cells, *centre, STEPS, TURNS, TURN, 0.0, excluded, BUDGET)
    assert max(abs(found[0] - centre.x), abs(found[1] - centre.y)) >= 4.0
    assert 0.0 < found[3] < 0.8


def test_the_budget_ends_the_search() -> None:
    field, cells = room(), seen_from(PLACE) / 0.1
    centre = field.pose_to_cells(ORIGIN)
    found = branching.branch_and_bound(field.pyramid(5), cells, *centre, STEPS, TURNS, TURN, 0.0, NOWHERE, 10)
    assert found[3] == -1.0
