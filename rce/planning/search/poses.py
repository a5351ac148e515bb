"""Compiled Hybrid-A*: a search over poses that a vehicle with a turning radius can drive.

Dolgov, Thrun, Montemerlo and Diebel, Practical Search Techniques in Path Planning for Autonomous Driving, 2008: states
are continuous, one for each cell and heading; curves to the goal are tried on the way (analytic expansion).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Points
from rce.mapping.matching.kernels import compiled
from rce.planning.costmap import BLOCKED, HIGHEST
from rce.planning.curves import kernels as curves
from rce.planning.search.cells import NOT_FOUND, STOPPED

HEADINGS = 72  # bins of 5 degrees
MAX_NODES = 1_000_000  # as max_iterations of Nav2
EXHAUSTED = -3
TABLE = 1 << 22  # slots of the hash table, a power of two
CHECK_EVERY = 256  # expansions from one look at the flag `stop` to the next
COLUMNS = 6  # of a node: x, y, theta, cost, parent, motion that led to it
SPACING = 1.0  # cells from one pose of a path to the next; each of them is tested
GREED = 1.3  # weight of the heuristic (Pohl 1970): paths are found far sooner, and are up to so much longer
NO_MOTION = -1.0
GOLDEN = 0x9E3779B97F4A7C15  # multiplier of Knuth's hash


class World(NamedTuple):
    """Costmap and footprint, in cells: the centre of cell (row, column) is at (column + 0.5, row + 0.5).

    Attributes:
        costs: (height, width) uint8, for the inscribed circle; blocked at the edge.
        clearance: (height, width) float32, cells to the nearest obstacle.
        outline: (n, 2) points that cover the footprint, cells, robot frame; empty for a circle.
        circumscribed: Radius around the footprint, cells.
    """

    costs: NDArray[np.uint8]
    clearance: NDArray[np.float32]
    outline: Points
    circumscribed: float


_WORLD = "uint8[:,::1], float32[:,::1], float64[:,::1], float64"


@compiled(f"float64({_WORLD}, float64, float64, float64)")
def pose_cost(
    costs: NDArray[np.uint8],
    clearance: NDArray[np.float32],
    outline: Points,
    circumscribed: float,
    x: float,
    y: float,
    theta: float,
) -> float:
    """Return the cost 0..1 of a pose, or -1 if the footprint collides."""
    height, width = costs.shape
    row, column = math.floor(y), math.floor(x)
    if not (0 <= row < height and 0 <= column < width) or costs[row, column] >= BLOCKED:
        return -1.0
    # Positions are continuous, clearances those of centres of cells: the two differ by less than a cell's diagonal.
    if outline.shape[0] and clearance[row, column] <= circumscribed + 1.5:
        c, s = math.cos(theta), math.sin(theta)
        for index in range(outline.shape[0]):
            px, py = outline[index]
            r, k = math.floor(y + s * px + c * py), math.floor(x + c * px - s * py)
            if not (0 <= r < height and 0 <= k < width) or clearance[r, k] == 0.0:
                return -1.0
    return float(costs[row, column]) / HIGHEST


@compiled(f"float64({_WORLD}, float64[:,::1])")
def path_cost(
    costs: NDArray[np.uint8],
    clearance: NDArray[np.float32],
    outline: Points,
    circumscribed: float,
    poses: NDArray[np.float64],
) -> float:
    """Return the mean cost 0..1 of poses (n, 3 or more), or -1 if one collides."""
    total = 0.0
    for index in range(poses.shape[0]):
        cost = pose_cost(costs, clearance, outline, circumscribed, poses[index, 0], poses[index, 1], poses[index, 2])
        if cost < 0:
            return -1.0
        total += cost
    return total / float(max(1, poses.shape[0]))


@compiled("UniTuple(float64, 2)(int64)")
def motion_of(number: int) -> tuple[float, float]:
    """Return the kind of curve of a motion 0..5, and 1 forward or -1 in reverse."""
    return float(number % 3 - 1), 1.0 if number < 3 else -1.0


@compiled("void(float64[:,::1], int64, float64, float64)")
def _heap_push(heap: NDArray[np.float64], size: int, key: float, node: float) -> None:
    """Add an entry to a binary heap (capacity, 2) that has `size` entries."""
    while size > 0:
        parent = (size - 1) // 2
        if heap[parent, 0] <= key:
            break
        heap[size, 0], heap[size, 1] = heap[parent, 0], heap[parent, 1]
        size = parent
    heap[size, 0], heap[size, 1] = key, node


@compiled("void(float64[:,::1], int64)")
def _heap_pop(heap: NDArray[np.float64], size: int) -> None:
    """Remove the first of `size` entries."""
    size -= 1
    key, node, at = heap[size, 0], heap[size, 1], 0
    while True:
        child = 2 * at + 1
        if child >= size:
            break
        if child + 1 < size and heap[child + 1, 0] < heap[child, 0]:
            child += 1
        if key <= heap[child, 0]:
            break
        heap[at, 0], heap[at, 1] = heap[child, 0], heap[child, 1]
        at = child
    heap[at, 0], heap[at, 1] = key, node


@compiled("float64[:,::1](int64, float64, float64, float64)")
def _shortest_curve(reverse: int, x: float, y: float, theta: float) -> curves.Curve:
    return curves.reeds_shepp(x, y, theta) if reverse else curves.dubins(x, y, theta)


@compiled("float64[:,::1](float64, float64, float64, float64, float64, float64, float64, int64)")
def curve_between(
    x: float, y: float, theta: float, goal_x: float, goal_y: float, goal_theta: float, radius: float, reverse: int
) -> curves.Curve:
    """Return the shortest curve between two poses; `radius` in the unit of the poses."""
    c, s = math.cos(theta), math.sin(theta)
    dx, dy = (goal_x - x) / radius, (goal_y - y) / radius
    return _shortest_curve(reverse, c * dx + s * dy, c * dy - s * dx, goal_theta - theta)


@compiled(
    f"int64({_WORLD}, float32[:,::1], float64[::1], float64[::1], float64, float64, int64, float64[::1], float64, "
    "uint8[::1], float64[:,::1], float64[:,::1], float64[:,::1])"
)
def hybrid_search(
    costs: NDArray[np.uint8],
    clearance: NDArray[np.float32],
    outline: Points,
    circumscribed: float,
    remaining: NDArray[np.float32],
    start: NDArray[np.float64],
    goal: NDArray[np.float64],
    radius: float,
    step: float,
    reverse: int,
    penalties: NDArray[np.float64],
    longest: float,
    stop: NDArray[np.uint8],
    nodes: NDArray[np.float64],
    heap: NDArray[np.float64],
    last: NDArray[np.float64],
) -> int:
    """Search a path from pose to pose. Lengths are in cells.

    Args:
        costs: See `World`, as for the next three.
        clearance: See `World`.
        outline: See `World`.
        circumscribed: See `World`.
        remaining: (height, width) cost from each cell to the goal for a robot that may turn anywhere.
        start: (3,) x, y, theta.
        goal: (3,) x, y, theta.
        radius: Turning radius.
        step: Length of a motion; an arc of this length turns by a whole number of bins.
        reverse: 1 for Reeds-Shepp, 0 for Dubins.
        penalties: (5,) factors of reverse motion and of arcs, price of a change of direction, weight of costs, and how
            much more often curves are tried as the goal comes closer.
        longest: Length of the longest curve to the goal that is tried.
        stop: (1,) another thread sets it to end the search.
        nodes: (MAX_NODES, COLUMNS) filled with the nodes.
        heap: (2 MAX_NODES, 2) space for the open list.
        last: (SEGMENTS, 2) filled with the curve from the last node to the goal.

    Returns:
        Index of the last node; NOT_FOUND, STOPPED, or EXHAUSTED if there are too many nodes.
    """
    width = costs.shape[1]
    table = np.full(TABLE, -1, np.int32)
    keys = np.empty(MAX_NODES, np.int64)
    closed = np.zeros(MAX_NODES, np.uint8)
    bin_size = 2 * math.pi / HEADINGS
    segment = np.zeros((curves.SEGMENTS, 2))
    nodes[0, :3], nodes[0, 3], nodes[0, 4], nodes[0, 5] = start, 0.0, -1.0, NO_MOTION
    keys[0] = -1  # the start itself is never found again, which costs one more node at most
    heap[0, 0], heap[0, 1] = 0.0, 0.0
    count, size, expanded, until_curve = 1, 1, 0, 0
    while size > 0:
        node = int(heap[0, 1])
        _heap_pop(heap, size)
        size -= 1
        if closed[node]:
            continue
        closed[node] = 1
        expanded += 1
        if expanded % CHECK_EVERY == 0 and stop[0]:
            return STOPPED
        x, y, theta, cost, before = nodes[node, 0], nodes[node, 1], nodes[node, 2], nodes[node, 3], nodes[node, 5]
        until_curve -= 1
        if until_curve <= 0:
            curve = curve_between(x, y, theta, goal[0], goal[1], goal[2], radius, reverse)
            length = np.abs(curve[:, 1]).sum() * radius
            # Far from the goal a curve seldom fits: it is tried more often as the goal comes closer.
            until_curve = int(length / step / penalties[4])
            if length <= longest or node == 0:
                poses = curves.sample(curve, x, y, theta, radius, SPACING)
                mean = path_cost(costs, clearance, outline, circumscribed, poses)
                limit = remaining[math.floor(y), math.floor(x)]
                if mean >= 0 and (length * (1 + penalties[3] * mean) <= 1.5 * limit + 2 * math.pi * radius):
                    last[:] = curve
                    return node
        for motion in range(6 if reverse else 3):
            kind, sign = motion_of(motion)
            scale = 1.0 if kind == 0 else radius
            dx, dy, after = curves.drive(0.0, 0.0, theta, kind, sign * step / scale)
            nx, ny = x + scale * dx, y + scale * dy
            segment[0, 0], segment[0, 1] = kind, sign * step / radius
            mean = path_cost(
                costs, clearance, outline, circumscribed, curves.sample(segment, x, y, theta, radius, SPACING)
            )
            if mean < 0:
                continue
            limit = remaining[math.floor(ny), math.floor(nx)]
            factor = (penalties[0] if sign < 0 else 1.0) * (penalties[1] if kind != 0 else 1.0)
            new = cost + step * (factor + penalties[3] * mean)
            if before != NO_MOTION and (before < 3) != (motion < 3):
                new += penalties[2]
            heading = np.int64(math.floor(after / bin_size + 0.5)) % HEADINGS
            key = (np.int64(math.floor(ny)) * width + np.int64(math.floor(nx))) * HEADINGS + heading
            slot = np.int64((np.uint64(key) * np.uint64(GOLDEN)) >> np.uint64(42))
            while table[slot] >= 0 and keys[table[slot]] != key:
                slot = (slot + 1) & (TABLE - 1)
            known = int(table[slot])
            if known >= 0 and (closed[known] or nodes[known, 3] <= new):
                continue
            if known < 0:
                if count == MAX_NODES:
                    return EXHAUSTED
                known = count
                keys[known] = key
                table[slot] = known
                count += 1
            nodes[known, 0], nodes[known, 1], nodes[known, 2] = nx, ny, after
            nodes[known, 3], nodes[known, 4], nodes[known, 5] = new, float(node), float(motion)
            curve = curve_between(nx, ny, after, goal[0], goal[1], goal[2], radius, reverse)
            estimate = max(np.abs(curve[:, 1]).sum() * radius, np.float64(limit))
            if size == heap.shape[0]:
                return EXHAUSTED
            _heap_push(heap, size, new + GREED * estimate, float(known))
            size += 1
    return NOT_FOUND
