"""Exact search of a large window of poses by branch and bound, and finding a place without ambiguity."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Points, Pose
from rce.mapping.matching.fields import downsample
from rce.mapping.matching.kernels import compiled

CHECK_INTERVAL = 16  # points between checks whether a pose can still reach the score that is required
NOTHING_EXCLUDED = np.zeros(5)  # `excluded` of a search that may return any pose


@dataclass(frozen=True, slots=True)
class PlaceSearch:
    """Settings of a search for a place in a map; see `find_place`.

    Attributes:
        resolution: Metres per cell of the field that is searched. Coarser than for matching: the result is refined.
        turn: Radians between the angles that are tried. At `view` metres this is about two cells.
        view: Metres from the place; points further off move too far with a small error of the angle.
        spacing: Metres between the points of the place that are searched for. Denser points add little information.
        max_points: Maximum number of these points; the cost of a search is proportional to it.
        min_points: Minimum number of these points; fewer fit everywhere.
        min_score: Mean likelihood (0..1) from which on a pose is accepted.
        budget: Poses scored before a search is given up, a bound of its time.
        rival_distance: Metres from the best pose, along x and y, within which another one is no rival.
        rival_turn: Radians from the best pose within which another one is no rival.
        rival_ratio: Share of the best score from which on a rival makes the place ambiguous.
    """

    spacing: float
    max_points: int
    min_points: int
    budget: int
    min_score: float = 0.6
    rival_distance: float = 0.8
    rival_ratio: float = 0.92
    rival_turn: float = math.radians(10)
    resolution: float = 0.1
    turn: float = math.radians(1)
    view: float = 15.0

    def points_in_view(self, points: Points) -> Points:
        """Return the points of a place that are searched for, of points (n, 2), metres, frame of the place."""
        near = points[np.hypot(points[:, 0], points[:, 1]) < self.view]
        return downsample(near, self.spacing, self.max_points)


def find_place(
    pyramid: NDArray[np.uint8],
    cells: Points,
    centre: Pose,
    steps: int,
    turns: int,
    settings: PlaceSearch,
    turn_to_best: bool = False,
) -> Pose | None:
    """Return the pose at which points fit a field, or None if they fit nowhere or at several places.

    The search is repeated with the surroundings of the best pose excluded. A place is ambiguous if a rival is found
    there, as in a corridor that looks the same all along, or if the budget ends that search.

    Args:
        pyramid: See `Field.pyramid`.
        cells: (n, 2) points in cells, frame of the robot.
        centre: Centre of the window, x and y in cells.
        steps: Cells on each side of the centre along x and y.
        turns: Angles on each side of the centre.
        settings: Thresholds and limits of the search.
        turn_to_best: Whether the angles of the search for rivals are centred on the best pose instead of on `centre`.
            For windows of a whole turn: rivals within `rival_turn` are recognised without wrapping of angles.

    Returns:
        The pose, x and y in cells.
    """

    def search(around: Pose, least: float, excluded: NDArray[np.float64]) -> list[float]:
        found: list[float] = branch_and_bound(
            pyramid, cells, *around, steps, turns, settings.turn, least, excluded, settings.budget
        ).tolist()
        return found

    x, y, theta, score = search(centre, settings.min_score, NOTHING_EXCLUDED)
    if score <= settings.min_score:
        return None
    rival = settings.rival_ratio * score
    excluded = np.array([x, y, theta, settings.rival_distance / settings.resolution, settings.rival_turn])
    around = centre._replace(theta=theta) if turn_to_best else centre
    if search(around, rival, excluded)[3] != rival:
        return None
    return Pose(x, y, theta)


@compiled("float64(uint8[:,::1], int32[:,::1], int64, int64, float64)")
def score(field: NDArray[np.uint8], cells: NDArray[np.int32], column: int, row: int, least: float) -> float:
    """Return the mean of a field (0..1) at translated cells, or 0 as soon as it cannot exceed `least`.

    Args:
        field: (height, width), 0 outside.
        cells: (n, 2) column, row.
        column: Translation.
        row: Translation.
        least: Score that has to be exceeded.
    """
    height, width = field.shape
    total, missing = 0, 255.0 * cells.shape[0] * (1.0 - least)
    for i in range(cells.shape[0]):
        if i % CHECK_INTERVAL == 0 and 255 * i - total > missing:
            return 0.0
        c, r = cells[i, 0] + column, cells[i, 1] + row
        if 0 <= c < width and 0 <= r < height:
            total += field[r, c]
    return float(total / (255.0 * cells.shape[0]))


@compiled(
    "float64[::1](uint8[:,:,::1], float64[:,::1], float64, float64, float64, int64, int64, float64, float64, "
    "float64[::1], int64)"
)
def branch_and_bound(
    pyramid: NDArray[np.uint8],
    points: NDArray[np.float64],
    x: float,
    y: float,
    theta: float,
    steps: int,
    turns: int,
    turn: float,
    least: float,
    excluded: NDArray[np.float64],
    budget: int,
) -> NDArray[np.float64]:
    """Return the likeliest pose in a window, by depth-first branch and bound.

    Hess et al., Real-Time Loop Closure in 2D LIDAR SLAM, 2016, section V-B, algorithm 3. A node of the search tree is
    an angle and a square of 2^level by 2^level translations; its bound is the score on that level of the pyramid.

    Args:
        pyramid: (levels, height, width), see `Field.pyramid`.
        points: (n, 2), cells, frame of the robot.
        x: Centre of the window, cells.
        y: Centre of the window, cells.
        theta: Centre of the window, radians.
        steps: Cells on each side of the centre along x and y.
        turns: Angles on each side of the centre.
        turn: Radians between angles.
        least: Score (0..1) that the pose has to exceed.
        excluded: (5,) x, y, theta, and how many cells and radians around them are left out.
        budget: Nodes after which the search is given up.

    Returns:
        (4,) x, y, theta and score of the best pose. The score is `least` if no pose exceeds it, and -1 if the search
        was given up.
    """
    top = pyramid.shape[0] - 1
    count = points.shape[0]
    # Rotate the points once for each angle; below, only translations are searched.
    angles = 2 * turns + 1
    cells = np.empty((angles, count, 2), np.int32)
    for a in range(angles):
        c, s = math.cos(theta + (a - turns) * turn), math.sin(theta + (a - turns) * turn)
        for i in range(count):
            cells[a, i, 0] = math.floor(x + c * points[i, 0] - s * points[i, 1] + 0.5)
            cells[a, i, 1] = math.floor(y + s * points[i, 0] + c * points[i, 1] + 0.5)
    # Compute the bounds of C0, the nodes that cover the window on the highest level.
    side = (2 * steps + (1 << top)) >> top
    first = np.empty(angles * side * side)
    for k in range(first.size):
        a, column, row = k // (side * side), k % side << top, k // side % side << top
        first[k] = score(pyramid[top], cells[a], column - steps, row - steps, least)
    # Depth-first search, the most promising node of C0 first. At most 4 children a level are on the stack.
    stack = np.empty((4 * top + 4, 4), np.int64)  # level, angle, column, row
    bounds = np.empty(4 * top + 4)
    best, found = least, np.array([x, y, theta, least])
    scored = 0
    for k in np.argsort(-first):
        if first[k] <= best:
            break
        depth = 1
        stack[0, 0], stack[0, 1] = top, k // (side * side)
        stack[0, 2], stack[0, 3] = (k % side << top) - steps, (k // side % side << top) - steps
        bounds[0] = first[k]
        while depth:
            depth -= 1
            # Bound: prune a node that cannot be better than the best leaf so far.
            if bounds[depth] <= best:
                continue
            level, a, column, row = stack[depth, 0], stack[depth, 1], stack[depth, 2], stack[depth, 3]
            # A leaf is a single pose, its bound the score.
            if level == 0:
                best = bounds[depth]
                found[0], found[1], found[2], found[3] = x + column, y + row, theta + (a - turns) * turn, best
                continue
            # Branch: split the square into its four quarters.
            half = 1 << (level - 1)
            base = depth
            for child in range(4):
                u, v = column + half * (child & 1), row + half * (child >> 1)
                if u > steps or v > steps:
                    continue
                # Leave out quarters that are excluded as a whole.
                near = abs(theta + (a - turns) * turn - excluded[2]) < excluded[4]
                left, low = x + u - excluded[0], y + v - excluded[1]
                if near and min(left, low) > -excluded[3] and max(left, low) + half - 1 < excluded[3]:
                    continue
                scored += 1
                bound = score(pyramid[level - 1], cells[a], u, v, best)
                if bound <= best:
                    continue
                # Push the children sorted by their bounds, the largest on top.
                place = depth
                while place > base and bounds[place - 1] > bound:
                    bounds[place] = bounds[place - 1]
                    stack[place] = stack[place - 1]
                    place -= 1
                bounds[place] = bound
                stack[place, 0], stack[place, 1], stack[place, 2], stack[place, 3] = level - 1, a, u, v
                depth += 1
            if scored > budget:
                found[3] = -1.0
                return found
    return found
