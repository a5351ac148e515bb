"""The planner `astar`."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rce.mapping.geometry import Pose
from rce.planning.astar import astar
from rce.planning.costmap import Costmap
from rce.planning.failures import NoPath, Reason
from rce.planning.search.deadline import Deadline
from tests.support.planning import ROBOT, exhaustive, grid_of, random_map, walled

START, GOAL = Pose(2.0, 2.0, 0.0), Pose(8.0, 2.0, 1.0)


def test_path_leads_around_a_wall_from_start_to_goal() -> None:
    points, cost = astar(Costmap(walled(), ROBOT), START, GOAL, 0.0, 2.0, Deadline(10))
    assert points[0].tolist() == [2.0, 2.0]
    assert points[-1].tolist() == [8.0, 2.0]
    assert points[:, 1].max() > 8.0
    assert cost >= np.hypot(*np.diff(points, axis=0).T).sum() * 0.99


def test_cost_is_that_of_an_exhaustive_search() -> None:
    costmap = Costmap(random_map(5, 80, 0.02), ROBOT)
    width = costmap.costs.shape[1]
    largest = int(np.bincount(costmap.regions[costmap.regions > 0]).argmax())
    cells = np.argwhere(costmap.regions == largest)
    (x, y), (u, v) = costmap.points(cells[[0, -1], 0], cells[[0, -1], 1]).tolist()
    _, cost = astar(costmap, Pose(x, y, 0), Pose(u, v, 0), 0.0, 2.0, Deadline(10))
    best = exhaustive(costmap, int(cells[0] @ (width, 1)), 2.0)[int(cells[-1] @ (width, 1))]
    assert math.isclose(cost, best / 70 * costmap.resolution)


@pytest.mark.parametrize(
    ("start", "goal", "reason"),
    [
        (Pose(-1, 2, 0), GOAL, Reason.START_OUTSIDE_MAP),
        (START, Pose(2, 99, 0), Reason.GOAL_OUTSIDE_MAP),
        (Pose(5.05, 2, 0), GOAL, Reason.START_OCCUPIED),
        (START, Pose(5.05, 2, 0), Reason.GOAL_OCCUPIED),
    ],
)
def test_error_says_what_is_wrong_with_an_end(start: Pose, goal: Pose, reason: Reason) -> None:
    with pytest.raises(NoPath) as raised:
        astar(Costmap(walled(), ROBOT), start, goal, 0.125, 2.0, Deadline(10))
    assert raised.value.reason is reason
    assert raised.value.info.fields == {"reason": reason.value}


def test_goal_behind_a_closed_wall_has_no_path() -> None:
    with pytest.raises(NoPath, match="no way") as raised:
        astar(Costmap(walled(gap=0), ROBOT), START, GOAL, 0.125, 2.0, Deadline(10))
    assert raised.value.reason is Reason.NO_VALID_PATH


def test_path_ends_near_a_goal_in_an_obstacle_within_the_tolerance() -> None:
    points, _ = astar(Costmap(walled(), ROBOT), START, Pose(5.0, 2.0, 0.0), 0.5, 2.0, Deadline(10))
    assert 0 < math.dist(points[-1], (5.0, 2.0)) <= 0.55


def test_path_from_a_cell_to_itself_has_both_ends() -> None:
    points, cost = astar(Costmap(walled(), ROBOT), START, Pose(2.01, 2.01, 0.0), 0.0, 2.0, Deadline(10))
    assert points.tolist() == [[2.0, 2.0], [2.01, 2.01]]
    assert cost == 0.0


def test_unknown_space_is_closed_unless_it_is_allowed() -> None:
    grid = grid_of(*["        ??        "] * 12)
    ends = Pose(0.3, 0.6, 0.0), Pose(1.4, 0.6, 0.0)
    with pytest.raises(NoPath):
        astar(Costmap(grid, ROBOT), *ends, 0.0, 2.0, Deadline(10))
    astar(Costmap(grid, ROBOT, allow_unknown=True), *ends, 0.0, 2.0, Deadline(10))


def test_search_that_was_stopped_reports_the_time() -> None:
    deadline = Deadline(5)
    deadline.stop()
    with pytest.raises(NoPath, match="within 5 s") as raised:
        astar(Costmap(walled(300), ROBOT), Pose(2, 2, 0), Pose(28, 2, 0), 0.0, 2.0, deadline)
    assert raised.value.reason is Reason.TIMEOUT
