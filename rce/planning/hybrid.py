"""Planner `hybrid`: a path that a vehicle with a turning radius and a footprint can drive (Hybrid-A*)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rce.api.map_jobs import MotionModel
from rce.mapping.geometry import Pose
from rce.planning import astar
from rce.planning.costmap import Costmap
from rce.planning.curves import kernels as curves
from rce.planning.failures import NoPath, Reason
from rce.planning.search import cells
from rce.planning.search.cells import STOPPED, STRAIGHT, UNREACHED, step_costs
from rce.planning.search.deadline import Deadline
from rce.planning.search.poses import (
    COLUMNS,
    EXHAUSTED,
    HEADINGS,
    MAX_NODES,
    SPACING,
    World,
    hybrid_search,
    motion_of,
    pose_cost,
)

EXTENT = 1.5  # the obstacle heuristic is computed for cells up to this multiple of the cost of the start


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Motion of a vehicle, and the costs of what it should avoid.

    Names and defaults are those of Nav2's Smac Hybrid-A* planner.

    Attributes:
        minimum_turning_radius: Metres.
        motion_model_for_search: DUBIN drives forward only, REEDS_SHEPP also in reverse.
        reverse_penalty: Factor of the cost of reverse motion.
        non_straight_penalty: Factor of the cost of arcs.
        change_penalty: Cost of a change between forward and reverse, metres.
        cost_penalty: Weight of the costmap beside the length.
        analytic_expansion_ratio: How much more often curves to the goal are tried as the goal comes closer.
        analytic_expansion_max_length: Longest curve to the goal that is tried, metres; at least five turning radii, as
            shorter curves may not exist.
    """

    minimum_turning_radius: float = 0.4
    motion_model_for_search: MotionModel = "DUBIN"
    reverse_penalty: float = 2.0
    non_straight_penalty: float = 1.2
    change_penalty: float = 0.0
    cost_penalty: float = 2.0
    analytic_expansion_ratio: float = 3.5
    analytic_expansion_max_length: float = 3.0


VEHICLE = Vehicle()


def hybrid(
    costmap: Costmap, start: Pose, goal: Pose, vehicle: Vehicle, deadline: Deadline
) -> tuple[NDArray[np.float64], float]:
    """Return a path that ends exactly at the goal.

    Args:
        costmap: Costs of the cells.
        start: Start, map frame.
        goal: Goal, map frame.
        vehicle: How the vehicle moves.
        deadline: Time limit.

    Returns:
        Poses (n, 4) x, y, theta in the map frame, and 1 if the pose is reached forward, -1 in reverse; and the length
        of the path, metres.

    Raises:
        NoPath: There is none, or none was found.
    """
    world = world_of(costmap)
    _check_ends(costmap, world, start, goal)
    remaining = _remaining(costmap, start, goal, vehicle.cost_penalty, deadline)
    reverse = int(vehicle.motion_model_for_search == "REEDS_SHEPP")
    radius = vehicle.minimum_turning_radius / costmap.resolution
    step = motion_length(radius)
    penalties = np.array(
        [
            vehicle.reverse_penalty,
            vehicle.non_straight_penalty,
            vehicle.change_penalty / costmap.resolution,
            vehicle.cost_penalty,
            vehicle.analytic_expansion_ratio,
        ]
    )
    longest = max(vehicle.analytic_expansion_max_length / costmap.resolution, 5 * radius)
    begin, end = (in_cells(costmap, each) for each in (start, goal))
    nodes, heap = np.empty((MAX_NODES, COLUMNS)), np.empty((2 * MAX_NODES, 2))
    last = np.empty((curves.SEGMENTS, 2))
    found = hybrid_search(
        *world, remaining, begin, end, radius, step, reverse, penalties, longest, deadline.flag, nodes, heap, last
    )
    if found == STOPPED:
        raise deadline.error()
    if found == EXHAUSTED:
        text = f"no path was found among {MAX_NODES:,} poses: plan with astar, or over a shorter distance"
        raise NoPath(text, Reason.TIMEOUT)
    if found < 0:
        raise astar.no_path(start, goal)
    poses = _poses(nodes, found, last, radius)
    length = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()) * costmap.resolution
    poses[:, :2] = poses[:, :2] * costmap.resolution + costmap.corner
    return poses, length


def world_of(costmap: Costmap) -> World:
    """Return what poses may collide with."""
    footprint, resolution = costmap.footprint, costmap.resolution
    return World(
        costmap.inscribed_costs,
        np.ascontiguousarray(costmap.clearance / np.float32(resolution)),
        footprint.samples(0.7 * resolution) / resolution,
        footprint.circumscribed / resolution,
    )


def in_cells(costmap: Costmap, pose: Pose) -> NDArray[np.float64]:
    """Return a pose (3,) in the unit of `World`."""
    return np.array([*(np.array(pose[:2]) - costmap.corner) / costmap.resolution, pose.theta])


def motion_length(radius: float) -> float:
    """Return the length of a motion, cells: it leaves the cell, and an arc of it turns by whole bins of the heading."""
    bins = math.ceil(2 * math.asin(min(1.0, math.sqrt(2) / (2 * radius))) / (2 * math.pi / HEADINGS))
    return radius * bins * 2 * math.pi / HEADINGS


def _check_ends(costmap: Costmap, world: World, start: Pose, goal: Pose) -> None:
    """Raise NoPath if start or goal are outside of the map, or the footprint collides there."""
    costmap.start(start.x, start.y, costmap.inscribed_costs)
    costmap.goal(goal.x, goal.y)
    if pose_cost(*world, *in_cells(costmap, start)) < 0:
        raise costmap.occupied("start", start.x, start.y)
    if pose_cost(*world, *in_cells(costmap, goal)) < 0:
        raise costmap.occupied("goal", goal.x, goal.y)


def _remaining(
    costmap: Costmap, start: Pose, goal: Pose, cost_penalty: float, deadline: Deadline
) -> NDArray[np.float32]:
    """Return the cost (height, width), cells, from each cell to the goal for the inscribed circle.

    Dolgov et al. call it the holonomic-with-obstacles heuristic. Cells that are much farther from the goal than the
    start have the cost of the farthest that was computed.

    Raises:
        NoPath: Not even the inscribed circle can go to the goal.
    """
    costs = costmap.inscribed_costs
    width = costs.shape[1]
    reached, arrivals = np.empty(costs.size, np.int32), np.empty(costs.size, np.uint8)
    begin, end = (row * width + column for row, column in (costmap.cell(*each[:2]) for each in (start, goal)))
    straight, diagonal, ring = step_costs(cost_penalty)
    found = cells.search(
        *(costs.ravel(), width, end, begin, straight, diagonal, ring, 0, EXTENT, reached, arrivals, deadline.flag)
    )
    if found == STOPPED:
        raise deadline.error()
    if found < 0:
        raise astar.no_path(start, goal)
    farthest = np.float32(max(found, 1) * EXTENT / STRAIGHT)
    remaining = np.where(reached == UNREACHED, farthest, reached / np.float32(STRAIGHT)).astype(np.float32)
    return remaining.reshape(costs.shape)


def _poses(nodes: NDArray[np.float64], last: int, curve: curves.Curve, radius: float) -> NDArray[np.float64]:
    """Return the poses (n, 4) of the path in cells: its motions and the curve to the goal."""
    chain = []
    node = last
    while node >= 0:
        chain.append(node)
        node = int(nodes[node, 4])
    ends = nodes[chain[::-1]]
    pieces = [np.array([[*ends[0, :3], 0.0]])]
    for before, after in pairwise(ends):
        motion = np.zeros((curves.SEGMENTS, 2))
        kind, sign = motion_of(int(after[5]))
        motion[0] = kind, sign * motion_length(radius) / radius
        pieces.append(curves.sample(motion, before[0], before[1], before[2], radius, SPACING))
    pieces.append(curves.sample(curve, ends[-1, 0], ends[-1, 1], ends[-1, 2], radius, SPACING))
    poses = np.concatenate(pieces)
    poses[0, 3] = poses[1, 3] if len(poses) > 1 else 1.0
    poses[:, 2] = (poses[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return poses
