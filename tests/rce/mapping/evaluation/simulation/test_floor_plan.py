"""Floor plan of the simulated apartment, and ranges in it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rce.mapping.evaluation.simulation.floor_plan import (
    DEPTH,
    DOOR,
    LOWER_DOORS,
    LOWER_WALLS,
    UPPER_WALLS,
    FloorPlan,
    apartment,
)


def test_ranges_in_a_square_room_are_exact() -> None:
    corners = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    room = FloorPlan(np.stack([corners, np.roll(corners, -1, axis=0)], axis=1))
    np.testing.assert_allclose(room.ranges(1.0, 1.0, math.pi / 2, 4, 2 * math.pi), [1.0, 3.0, 3.0, 1.0])
    np.testing.assert_allclose(room.distance(np.array([[1.0, 2.0], [5.0, 4.0]])), [1.0, 1.0])


def test_apartment_has_six_rooms() -> None:
    assert len(LOWER_WALLS) + len(UPPER_WALLS) + 2 == 6
    assert apartment().walls.shape[1:] == (2, 2)


def test_beam_that_meets_no_wall_has_no_range() -> None:
    wall = FloorPlan(np.array([[[2.0, -1.0], [2.0, 1.0]]]))
    ranges = wall.ranges(0.0, 0.0, 0.0, 4, 2 * math.pi)  # behind, to the right, ahead, to the left
    assert ranges.tolist() == [math.inf, math.inf, pytest.approx(2.0), math.inf]


def test_first_of_several_walls_ends_the_beam() -> None:
    walls = FloorPlan(np.array([[[x, -1.0], [x, 1.0]] for x in (5.0, 2.0, 9.0)]))
    assert walls.ranges(0.0, 0.0, 0.0, 4, 2 * math.pi)[2] == pytest.approx(2.0)


def test_doors_are_open_and_outer_walls_closed() -> None:
    plan = apartment()
    middle = LOWER_DOORS[0] + DOOR / 2
    down = plan.ranges(middle, 5.5, -math.pi / 2, 4, 2 * math.pi)[2]
    assert down > 2.0, "the beam enters the room through its door"
    assert np.isfinite(plan.ranges(middle, 5.5, 0.0, 720, 2 * math.pi)).all()
    assert plan.distance(np.array([[middle, 0.0], [middle, DEPTH]])) == pytest.approx([0.0, 0.0], abs=1e-9)
