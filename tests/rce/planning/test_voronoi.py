"""Ridges, the Voronoi graph, and paths along them."""

from __future__ import annotations

import numpy as np

from rce.bench.planning import building
from rce.mapping.geometry import Pose
from rce.planning.costmap import Costmap
from rce.planning.search.deadline import Deadline
from rce.planning.voronoi import graph, ridges, thin, voronoi
from tests.support.planning import ROBOT, grid_of

CORRIDOR = ["#" * 60, *[" " * 60] * 9, "#" * 60]


def test_ridge_of_a_corridor_is_its_middle() -> None:
    costmap = Costmap(grid_of(*CORRIDOR), ROBOT)
    rows, columns = np.nonzero(ridges(costmap))
    inner = (columns > 12) & (columns < 50)
    assert set(rows[inner].tolist()) <= {5, 6, 7}  # the middle row is 6, with the border
    assert set(columns[inner].tolist()) == set(range(13, 50))


def test_path_follows_the_middle() -> None:
    costmap = Costmap(grid_of(*CORRIDOR), ROBOT)
    points, length = voronoi(costmap, Pose(0.5, 0.3, 0), Pose(5.5, 0.3, 0), 0.0, Deadline(10))
    assert points[0].tolist() == [0.5, 0.3]
    assert points[-1].tolist() == [5.5, 0.3]
    middle = points[(points[:, 0] > 1.5) & (points[:, 0] < 4.5)]
    assert np.abs(middle[:, 1] - 0.55).max() <= 0.11
    assert length >= 5.0


def test_graph_of_a_building_is_made_of_lines_that_keep_clear() -> None:
    costmap = Costmap(building(), ROBOT)
    edges = graph(costmap)
    assert len(edges) > 20
    for edge in edges:
        assert edge.clearance > ROBOT.circumscribed
        steps = np.hypot(*np.diff(edge.points, axis=0).T)
        assert (steps <= 1.5 * costmap.resolution).all()


def test_thinned_shape_is_a_line_of_one_cell() -> None:
    cells = np.zeros((9, 30), np.bool_)
    cells[3:6, 3:27] = True
    thin(cells)
    assert cells.sum(axis=0).max() == 1
    assert cells.any(axis=0).sum() >= 20
