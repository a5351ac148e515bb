"""Compiled inner loops of grids and of correlative scan matching.

Each kernel has an explicit signature: Numba compiles it at import (a few seconds), and no scan waits for the compiler.
The machine code is cached on disk for the next process. Kernels release the GIL. Grids are indexed [row, column] = [y,
x]. Coordinates are in cells: the centre of cell (row, column) is at (column, row).
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from functools import cache
from typing import TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

SATURATED = 250  # likelihood (0..255) of a cell from which on another hit in it changes next to nothing

F = TypeVar("F", bound=Callable[..., object])

log = logging.getLogger(__name__)


@cache
def _announce_compilation() -> None:
    log.warning("compiling numerical kernels; this takes up to a minute, and the result is kept where possible")


def compiled(signature: str) -> Callable[[F], F]:
    """Return a decorator that compiles a function at once for this signature.

    Where no directory for the cache is writable, the function is compiled again at each start.
    """

    def decorate(function: F) -> F:
        try:
            made = numba.njit(signature, cache=True, nogil=True)(function)
            if made.stats.cache_misses:
                _announce_compilation()
            return cast(F, made)
        except RuntimeError as error:
            if "cannot cache" not in str(error):
                raise
            _announce_compilation()
            return cast(F, numba.njit(signature, nogil=True)(function))

    return decorate


@compiled("void(uint8[:,::1], float64[:,::1], float64)")
def stamp_hits(field: NDArray[np.uint8], hits: NDArray[np.float64], sigma: float) -> None:
    """Raise a likelihood field around each hit to 255 exp(-d^2 / 2 sigma^2), where d is the distance from the hit.

    This is the likelihood field of Thrun, Burgard and Fox, Probabilistic Robotics, 2005, section 6.4, without the terms
    for random measurements and for the maximum range.

    Args:
        field: (height, width), changed in place.
        hits: (n, 2) x, y in cells. Hits closer to the edge than the reach of the likelihood are ignored, and so are
            those in a cell that is `SATURATED`.
        sigma: Standard deviation of a measurement, cells.
    """
    height, width = field.shape
    # The Gaussian is cut off at 2.5 sigma, where 255 exp(-3.1) is 11.
    reach = math.ceil(2.5 * sigma)
    scale = -0.5 / (sigma * sigma)
    for i in range(hits.shape[0]):
        x, y = hits[i, 0], hits[i, 1]
        column, row = math.floor(x + 0.5), math.floor(y + 0.5)
        if not (reach <= column < width - reach and reach <= row < height - reach) or field[row, column] >= SATURATED:
            continue
        # The nearest hit decides: the maximum over all hits is the likelihood of the smallest distance.
        for r in range(row - reach, row + reach + 1):
            for c in range(column - reach, column + reach + 1):
                value = np.uint8(255.0 * math.exp(scale * ((c - x) ** 2 + (r - y) ** 2)) + 0.5)
                if value > field[r, c]:
                    field[r, c] = value


@compiled("void(int16[:,::1], float64, float64, float64[:,::1], int64, int64, int64)")
def trace_rays(
    log_odds: NDArray[np.int16], x: float, y: float, hits: NDArray[np.float64], hit: int, miss: int, limit: int
) -> None:
    """Update log-odds along beams: lower the cells passed by each beam, raise the cell in which it ends.

    The cells along a beam are walked as in Amanatides and Woo, A Fast Voxel Traversal Algorithm for Ray Tracing, 1987.

    Args:
        log_odds: (height, width), changed in place.
        x: Sensor, cells.
        y: Sensor, cells.
        hits: (n, 2) x, y of the ends of the beams, cells; all inside the grid.
        hit: Added where a beam ended.
        miss: Subtracted where a beam passed.
        limit: Bound of the absolute value.
    """
    start_column, start_row = math.floor(x + 0.5), math.floor(y + 0.5)
    for i in range(hits.shape[0]):
        column, row = start_column, start_row
        end_column, end_row = math.floor(hits[i, 0] + 0.5), math.floor(hits[i, 1] + 0.5)
        # Initialisation: the beam is sensor + t * (dx, dy) with t in [0, 1]. `delta` is the t that crosses one cell,
        # `next` the t at which the beam leaves the current cell.
        dx, dy = hits[i, 0] - x, hits[i, 1] - y
        step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        delta_x = abs(1.0 / dx) if dx != 0.0 else 1e30
        delta_y = abs(1.0 / dy) if dy != 0.0 else 1e30
        next_x = (0.5 + step_x * (column - x)) * delta_x
        next_y = (0.5 + step_y * (row - y)) * delta_y
        # Incremental traversal: step into the neighbour whose border the beam crosses first.
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
    """Search a lattice of poses exhaustively for the one at which the points are likeliest.

    Correlative scan matching by 2D slices of constant angle (Olson, Real-Time Correlative Scan Matching, 2009).

    Args:
        field: (height, width) likelihood field.
        points: (n, 2), cells, frame of the robot.
        x: Centre of the lattice, cells.
        y: Centre of the lattice, cells.
        theta: Centre of the lattice, radians.
        stride: Cells between neighbours along x and y.
        steps: Neighbours on each side of the centre along x and y: 2 steps + 1 positions along each axis.
        turns: Angles on each side of the centre: 2 turns + 1 angles.
        turn: Radians between angles.
        move_cost: Penalty for leaving the centre, per square cell.
        turn_cost: Penalty for leaving the centre, per square radian.

    Returns:
        x, y, theta of the best pose and its score: the mean likelihood (0..1) of the points less the penalties. Points
        outside the field count as 0.
    """
    height, width = field.shape
    flat = field.ravel()
    count = points.shape[0]
    cells = np.empty(count, np.int64)
    margin = stride * steps
    best, best_x, best_y, best_theta = -1e30, x, y, theta
    for a in range(-turns, turns + 1):
        # Rotate the points once for each angle, the outer loop. Points that could leave the field are left out.
        angle = theta + a * turn
        c, s = math.cos(angle), math.sin(angle)
        used = 0
        for i in range(count):
            column = math.floor(x + c * points[i, 0] - s * points[i, 1] + 0.5)
            row = math.floor(y + s * points[i, 0] + c * points[i, 1] + 0.5)
            if margin <= column < width - margin and margin <= row < height - margin:
                cells[used] = row * width + column
                used += 1
        # Translate them by whole cells in the inner loops: each is one lookup at a constant offset.
        for v in range(-steps, steps + 1):
            for u in range(-steps, steps + 1):
                offset = stride * (v * width + u)
                total = 0
                for i in range(used):
                    total += flat[cells[i] + offset]
                # The prior: penalties that grow with the square of the distance from the prediction.
                cost = move_cost * stride * stride * (u * u + v * v) + turn_cost * (a * turn) ** 2
                score = total / (255.0 * count) - cost
                if score > best:
                    best, best_x, best_y, best_theta = score, x + stride * u, y + stride * v, angle
    return best_x, best_y, best_theta, best
