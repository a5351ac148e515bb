"""Planner `astar`: the cheapest 8-connected path over the cells of a costmap, as Nav2's Smac 2D planner means it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Points, Pose
from rce.planning.costmap import BLOCKED, Costmap
from rce.planning.failures import NoPath
from rce.planning.search.cells import STOPPED, STRAIGHT, search, step_costs, trace
from rce.planning.search.deadline import Deadline


def astar(
    costmap: Costmap, start: Pose, goal: Pose, tolerance: float, cost_travel_multiplier: float, deadline: Deadline
) -> tuple[Points, float]:
    """Return the cheapest path for the robot's circumscribed circle, which may turn anywhere.

    Args:
        costmap: Costs of the cells.
        start: Start, map frame.
        goal: Goal, map frame.
        tolerance: Metres from the goal at which the path may end if the goal cannot be reached.
        cost_travel_multiplier: Weight of the costs beside the length; 0 for the shortest path.
        deadline: Time limit.

    Returns:
        Points (n, 2), metres, map frame, from the start to the goal, and the cost of the path, metres in free space.

    Raises:
        NoPath: There is none.
    """
    return path_over(costmap, costmap.costs, cost_travel_multiplier, (start, goal), tolerance, deadline)


def path_over(
    costmap: Costmap,
    costs: NDArray[np.uint8],
    multiplier: float,
    between: tuple[Pose, Pose],
    tolerance: float,
    deadline: Deadline,
) -> tuple[Points, float]:
    """Return the cheapest path over the cells of a costmap by other costs (height, width); see `astar`."""
    start, goal = between
    begin, end = ends(costmap, start, goal, tolerance)
    width = costs.shape[1]
    reached, arrivals = np.empty(costs.size, np.int32), np.empty(costs.size, np.uint8)
    straight, diagonal, ring = step_costs(multiplier)
    last = end[0] * width + end[1]
    first = begin[0] * width + begin[1]
    found = search(
        costs.ravel(), width, first, last, straight, diagonal, ring, 1, 0.0, reached, arrivals, deadline.flag
    )
    if found == STOPPED:
        raise deadline.error()
    if found < 0:  # with paths of half a million kilometres only, as both cells are in one region
        raise no_path(start, goal)
    cells = trace(arrivals, width, last)
    points = costmap.points(cells // width, cells % width)
    return with_ends(points, start, goal, costmap.cell(goal.x, goal.y) == end), found / STRAIGHT * costmap.resolution


def ends(costmap: Costmap, start: Pose, goal: Pose, tolerance: float) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the first and the last cell of a path: the goal, or the nearest one within `tolerance` (metres).

    Raises:
        NoPath: Start or goal are outside of the map or blocked, or the goal cannot be reached.
    """
    begin, wanted = costmap.start(start.x, start.y, costmap.costs), costmap.goal(goal.x, goal.y)
    regions = costmap.regions
    if regions[wanted] == regions[begin]:
        return begin, wanted
    reach = math.floor(tolerance / costmap.resolution)
    (row, column), (height, width) = wanted, regions.shape
    low, left = max(row - reach, 0), max(column - reach, 0)
    near = regions[low : min(row + reach + 1, height), left : min(column + reach + 1, width)] == regions[begin]
    rows, columns = (each.astype(np.int64) for each in np.nonzero(near))
    distance = np.hypot(rows + low - row, columns + left - column)
    if distance.size == 0 or distance.min() > reach:
        raise costmap.occupied("goal", goal.x, goal.y) if costmap.costs[wanted] >= BLOCKED else no_path(start, goal)
    best = int(distance.argmin())
    return begin, (int(rows[best]) + low, int(columns[best]) + left)


def no_path(start: Pose, goal: Pose) -> NoPath:
    """Return the error of a goal that cannot be reached."""
    return NoPath(
        f"there is no way from ({start.x:g}, {start.y:g}) to ({goal.x:g}, {goal.y:g}) that is wide enough for the "
        "robot's footprint; unknown space is closed unless it is allowed (allow_unknown)",
    )


def with_ends(points: Points, start: Pose, goal: Pose, exact: bool) -> NDArray[np.float64]:
    """Return points whose first is the start, and whose last is the goal if it was reached exactly."""
    points[0] = start[:2]
    if exact:
        if len(points) == 1:
            points = np.repeat(points, 2, axis=0)
        points[-1] = goal[:2]
    return points
