"""The inner loops, compiled by Numba.

The signatures are given, so that importing compiles everything (a few seconds) and no scan waits for it; the machine
code is cached on disk for the next process. They release the GIL. Grids are indexed [row, column] = [y, x]. Coordinates
are in cells: the centre of cell (row, column) is at (column, row).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

STAMPED = 250  # likelihood of a cell in which a hit says nothing new

F = TypeVar("F", bound=Callable[..., object])


def compiled(signature: str) -> Callable[[F], F]:
    """Compile now, for this signature. Without a directory that can be written there is no cache, only a slow start."""

    def decorate(function: F) -> F:
        try:
            return cast(F, numba.njit(signature, cache=True, nogil=True)(function))
        except RuntimeError as error:
            if "cannot cache" not in str(error):
                raise
            return cast(F, numba.njit(signature, nogil=True)(function))

    return decorate


@compiled("void(uint8[:,::1], float64[:,::1], float64)")
def stamp_hits(field: NDArray[np.uint8], hits: NDArray[np.float64], sigma: float) -> None:
    """Raise the likelihood field around each hit (n, 2) to 255 exp(-d^2 / 2 sigma^2); `sigma` and d in cells.

    Hits too near the edge are ignored, and those that would change next to nothing.
    """
    height, width = field.shape
    reach = math.ceil(2.5 * sigma)
    scale = -0.5 / (sigma * sigma)
    for i in range(hits.shape[0]):
        x, y = hits[i, 0], hits[i, 1]
        column, row = math.floor(x + 0.5), math.floor(y + 0.5)
        if not (reach <= column < width - reach and reach <= row < height - reach) or field[row, column] >= STAMPED:
            continue
        for r in range(row - reach, row + reach + 1):
            for c in range(column - reach, column + reach + 1):
                value = np.uint8(255.0 * math.exp(scale * ((c - x) ** 2 + (r - y) ** 2)) + 0.5)
                if value > field[r, c]:
                    field[r, c] = value


@compiled("void(int16[:,::1], float64, float64, float64[:,::1], int64, int64, int64)")
def trace_rays(
    log_odds: NDArray[np.int16], x: float, y: float, hits: NDArray[np.float64], hit: int, miss: int, limit: int
) -> None:
    """Lower the cells between the sensor at (x, y) and each hit (n, 2) by `miss`, raise those hit by `hit`.

    Cells are walked as by Amanatides and Woo, A Fast Voxel Traversal Algorithm (1987).
    """
    start_column, start_row = math.floor(x + 0.5), math.floor(y + 0.5)
    for i in range(hits.shape[0]):
        column, row = start_column, start_row
        end_column, end_row = math.floor(hits[i, 0] + 0.5), math.floor(hits[i, 1] + 0.5)
        dx, dy = hits[i, 0] - x, hits[i, 1] - y
        step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        delta_x = abs(1.0 / dx) if dx != 0.0 else 1e30
        delta_y = abs(1.0 / dy) if dy != 0.0 else 1e30
        next_x = (0.5 + step_x * (column - x)) * delta_x
        next_y = (0.5 + step_y * (row - y)) * delta_y
        for _ in range(abs(end_column - column) + abs(end_row - row)):
            log_odds[row, column] = max(log_odds[row, column] - miss, -limit)
            if next_x < next_y:
                next_x += delta_x
                column += step_x
            else:
                next_y += delta_y
                row += step_y
        log_odds[end_row, end_column] = min(log_odds[end_row, end_column] + hit, limit)


@compiled(
    "Tuple((float64, float64, float64, float64))(uint8[:,::1], float64[:,::1], "
    "float64, float64, float64, int64, int64, int64, float64, float64, float64)"
)
def correlate(
    field: NDArray[np.uint8],
    points: NDArray[np.float64],
    x: float,
    y: float,
    theta: float,
    stride: int,
    steps: int,
    turns: int,
    turn: float,
    move_cost: float,
    turn_cost: float,
) -> tuple[float, float, float, float]:
    """The best pose on a lattice around (x, y, theta), by exhaustive search (Olson, Real-Time Correlative Scan
    Matching, 2009), and its score: the mean likelihood (0..1) of the points less the cost of leaving the centre.

    The lattice has 2 steps + 1 places `stride` cells apart along x and y and 2 turns + 1 angles `turn` radians apart.
    `points`: (n, 2), cells, frame of the robot. Costs: per square cell, per square radian.
    """
    height, width = field.shape
    flat = field.ravel()
    count = points.shape[0]
    cells = np.empty(count, np.int64)
    margin = stride * steps
    best, best_x, best_y, best_theta = -1e30, x, y, theta
    for a in range(-turns, turns + 1):
        angle = theta + a * turn
        c, s = math.cos(angle), math.sin(angle)
        used = 0
        for i in range(count):
            column = math.floor(x + c * points[i, 0] - s * points[i, 1] + 0.5)
            row = math.floor(y + s * points[i, 0] + c * points[i, 1] + 0.5)
            if margin <= column < width - margin and margin <= row < height - margin:
                cells[used] = row * width + column
                used += 1
        for v in range(-steps, steps + 1):
            for u in range(-steps, steps + 1):
                offset = stride * (v * width + u)
                total = 0
                for i in range(used):
                    total += flat[cells[i] + offset]
                cost = move_cost * stride * stride * (u * u + v * v) + turn_cost * (a * turn) ** 2
                score = total / (255.0 * count) - cost
                if score > best:
                    best, best_x, best_y, best_theta = score, x + stride * u, y + stride * v, angle
    return best_x, best_y, best_theta, best
