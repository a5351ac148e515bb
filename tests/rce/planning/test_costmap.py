"""Costs of cells."""

from __future__ import annotations

import math

import numpy as np

from rce.mapping.grid import OccupancyGrid
from rce.planning.costmap import BLOCKED, HIGHEST, LETHAL, Costmap, Inflation
from rce.planning.footprint import Footprint
from tests.support.planning import grid_of


def with_one_obstacle(footprint: Footprint) -> Costmap:
    cells = np.zeros((101, 101), np.int8)
    cells[50, 50] = 100
    return Costmap(OccupancyGrid(cells, 0.05, 1.0, 2.0), footprint, Inflation(0.6, 3.0))


def test_costs_fall_exponentially_from_the_radius_of_the_robot() -> None:
    costs = with_one_obstacle(Footprint.circle(0.2)).costs
    assert costs[51, 51] == LETHAL
    assert (costs[51, 52:56] == BLOCKED).all()  # up to 0.2 m
    for cells in range(5, 12):
        assert costs[51, 51 + cells] == int(HIGHEST * math.exp(-3.0 * (0.05 * cells - 0.2)))
    assert costs[51, 51 + 13] == 0


def test_robot_that_is_not_round_has_two_kinds_of_costs() -> None:
    costmap = with_one_obstacle(Footprint.polygon(((0.4, 0.1), (0.4, -0.1), (-0.4, -0.1), (-0.4, 0.1))))
    assert costmap.costs[51, 51 + 8] == BLOCKED  # it cannot turn there
    assert costmap.inscribed_costs[51, 51 + 2] == BLOCKED
    assert costmap.inscribed_costs[51, 51 + 3] < BLOCKED


def test_edge_of_the_map_is_a_wall() -> None:
    costs = with_one_obstacle(Footprint.circle(0.2)).costs
    assert (costs[0] == LETHAL).all()
    assert (costs[1:-1, 1] == BLOCKED).all()


def test_cells_and_points_are_those_of_the_map() -> None:
    costmap = with_one_obstacle(Footprint.circle(0.2))
    assert costmap.cell(1.0 + 50.5 * 0.05, 2.0 + 0.001) == (1, 51)
    assert np.allclose(costmap.points(np.array([1]), np.array([51])), [[1.0 + 50.5 * 0.05, 2.025]])


def test_regions_are_parts_between_which_there_is_no_way() -> None:
    costmap = Costmap(grid_of(*["      #      "] * 9), Footprint.circle(0.15))
    left, right = costmap.regions[5, 4], costmap.regions[5, 10]
    assert left != right
    assert 0 not in (left, right)
    assert costmap.regions[5, 7] == 0
