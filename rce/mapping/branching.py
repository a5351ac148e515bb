"""Search of a large window of poses, exact and fast."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rce.mapping.kernels import compiled

CHECK = 16  # points between looks at whether it is any good


@compiled("float64(uint8[:,::1], int32[:,::1], int64, int64, float64)")
def score(field: NDArray[np.uint8], cells: NDArray[np.int32], column: int, row: int, least: float) -> float:
    """Mean of the field (0..1) at `cells` (n, 2: column, row) moved by `column` and `row`; nothing is outside. 0 as
    soon as it cannot be more than `least`."""
    height, width = field.shape
    total, missing = 0, 255.0 * cells.shape[0] * (1.0 - least)
    for i in range(cells.shape[0]):
        if i % CHECK == 0 and 255 * i - total > missing:
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
    """The likeliest pose within `steps` cells along x and y and `turns` angles of `turn` radians of (x, y, theta), by
    depth-first branch and bound (Hess et al., Real-Time Loop Closure in 2D LIDAR SLAM, 2016, algorithm 3).

    `pyramid`: see Field.pyramid. `points`: (n, 2), cells, frame of the robot. `excluded`: x, y, theta, and how many
    cells and radians around them are not searched. Returns x, y, theta and the score (0..1) of the best pose; its score
    is `least` where none is better, and -1 where more than `budget` poses would have to be looked at.
    """
    top = pyramid.shape[0] - 1
    count = points.shape[0]
    angles = 2 * turns + 1
    cells = np.empty((angles, count, 2), np.int32)
    for a in range(angles):
        c, s = math.cos(theta + (a - turns) * turn), math.sin(theta + (a - turns) * turn)
        for i in range(count):
            cells[a, i, 0] = math.floor(x + c * points[i, 0] - s * points[i, 1] + 0.5)
            cells[a, i, 1] = math.floor(y + s * points[i, 0] + c * points[i, 1] + 0.5)
    side = (2 * steps + (1 << top)) >> top
    first = np.empty(angles * side * side)
    for k in range(first.size):
        a, column, row = k // (side * side), k % side << top, k // side % side << top
        first[k] = score(pyramid[top], cells[a], column - steps, row - steps, least)
    stack = np.empty((4 * top + 4, 4), np.int64)  # level, angle, column, row
    bounds = np.empty(4 * top + 4)
    best, found = least, np.array([x, y, theta, least])
    looked = 0
    for k in np.argsort(-first):
        if first[k] <= best:
            break
        depth = 1
        stack[0, 0], stack[0, 1] = top, k // (side * side)
        stack[0, 2], stack[0, 3] = (k % side << top) - steps, (k // side % side << top) - steps
        bounds[0] = first[k]
        while depth:
            depth -= 1
            if bounds[depth] <= best:
                continue
            level, a, column, row = stack[depth, 0], stack[depth, 1], stack[depth, 2], stack[depth, 3]
            if level == 0:
                best = bounds[depth]
                found[0], found[1], found[2], found[3] = x + column, y + row, theta + (a - turns) * turn, best
                continue
            half = 1 << (level - 1)
            base = depth
            for child in range(4):
                u, v = column + half * (child & 1), row + half * (child >> 1)
                if u > steps or v > steps:
                    continue
                near = abs(theta + (a - turns) * turn - excluded[2]) < excluded[4]
                left, low = x + u - excluded[0], y + v - excluded[1]
                if near and min(left, low) > -excluded[3] and max(left, low) + half - 1 < excluded[3]:
                    continue
                looked += 1
                bound = score(pyramid[level - 1], cells[a], u, v, best)
                if bound <= best:
                    continue
                place = depth  # the children are kept in order, the best on top
                while place > base and bounds[place - 1] > bound:
                    bounds[place] = bounds[place - 1]
                    stack[place] = stack[place - 1]
                    place -= 1
                bounds[place] = bound
                stack[place, 0], stack[place, 1], stack[place, 2], stack[place, 3] = level - 1, a, u, v
                depth += 1
            if looked > budget:
                found[3] = -1.0
                return found
    return found
