"""Normal distributions transform (NDT): a map of normal distributions of hits, and fitting scans to it.

Biber and Strasser, The Normal Distributions Transform: A New Approach to Laser Scan Matching, 2003; see also Magnusson,
The Three-Dimensional Normal-Distributions Transform, 2009, chapter 6. The map is divided into coarse cells; each holds
the mean and the covariance of the hits in it. Since these average over all scans, a wall stays as sharp as the sensor
sees it, however often it is seen.

Cells are stored in tiles of TILE by TILE: `tiles` (n, TILE, TILE, FIELDS) float32. `table` (rows, columns) int32 holds
the index of the tile at each place of the map, -1 where there is none, so that several maps can share tiles. The unit
of length is the fine cell, that of the likelihood field; a coarse cell is `ratio` fine cells wide.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.matching.kernels import compiled

FIELDS = 6  # of a cell: count, mean x, mean y (from its centre), covariance xx, xy, yy; fine cells
SHIFT = 4
TILE = 1 << SHIFT  # coarse cells along each side of a tile


@dataclass(frozen=True, slots=True)
class NdtSettings:
    """Settings of the normal distributions and of the fit.

    Attributes:
        min_hits: Hits from which on a cell is used. The covariance of fewer means nothing.
        max_hits: Hits after which a cell forgets old ones exponentially, so that it follows changes of the building.
        pull: Weight of the expected position for each point on known walls, information per square fine cell. It
            decides in directions that the walls leave open, as those of a corridor do, and hardly matters elsewhere.
        turn_pull: The same for the expected heading, information per square radian.
        turn_limit: Radians by which one iteration may turn; beyond, the linearisation does not hold.
        move_tolerance: Fine cells; with `turn_tolerance`, a smaller step ends the iteration.
        turn_tolerance: Radians.
    """

    min_hits: float = 3.0
    max_hits: float = 100.0
    pull: float = 1e-3
    turn_pull: float = 1e-2
    turn_limit: float = 0.05
    move_tolerance: float = 2e-3
    turn_tolerance: float = 1e-5


SETTINGS = NdtSettings()
# Kernels take plain numbers; Numba compiles these in as constants.
MIN_HITS, MAX_HITS, PULL, TURN_PULL = SETTINGS.min_hits, SETTINGS.max_hits, SETTINGS.pull, SETTINGS.turn_pull
TURN_LIMIT, MOVE_TOLERANCE, TURN_TOLERANCE = SETTINGS.turn_limit, SETTINGS.move_tolerance, SETTINGS.turn_tolerance


@compiled("UniTuple(int64, 3)(float32[:,:,:,::1], int32[:,::1], int64, int64)")
def known_cell(tiles: NDArray[np.float32], table: NDArray[np.int32], column: int, row: int) -> tuple[int, int, int]:
    """Return the index in `tiles` of the cell at a place of the map; the tile is -1 if there is no distribution.

    Args:
        tiles: Tiles of the map.
        table: Index of the tile at each place.
        column: Coarse cells, inside the map.
        row: Coarse cells, inside the map.
    """
    tile, r, c = table[row >> SHIFT, column >> SHIFT], row & TILE - 1, column & TILE - 1
    if tile >= 0 and tiles[tile, r, c, 0] < MIN_HITS:
        return -1, r, c
    return tile, r, c


@compiled("void(float32[:,:,:,::1], int32[:,::1], float64[:,::1], int64)")
def learn(tiles: NDArray[np.float32], table: NDArray[np.int32], hits: NDArray[np.float64], ratio: int) -> None:
    """Add hits to the normal distributions of their cells.

    Args:
        tiles: Tiles, changed in place.
        table: Index of the tile at each place; hits where there is none are ignored.
        hits: (n, 2) x, y, fine cells.
        ratio: Fine cells along a coarse one.
    """
    height, width = table.shape[0] << SHIFT, table.shape[1] << SHIFT
    for i in range(hits.shape[0]):
        x, y = (hits[i, 0] + 0.5) / ratio - 0.5, (hits[i, 1] + 0.5) / ratio - 0.5
        column, row = math.floor(x + 0.5), math.floor(y + 0.5)
        if not (0 <= column < width and 0 <= row < height):
            continue
        tile = table[row >> SHIFT, column >> SHIFT]
        if tile < 0:
            continue
        # Recursive mean and covariance (Welford). With the count held at its maximum this is exponential forgetting.
        cell = tiles[tile, row & TILE - 1, column & TILE - 1]
        count = min(cell[0] + 1.0, MAX_HITS)
        dx, dy = (x - column) * ratio - cell[1], (y - row) * ratio - cell[2]
        rest = 1.0 - 1.0 / count
        cell[0] = count
        cell[1] += dx / count
        cell[2] += dy / count
        cell[3] = rest * (cell[3] + dx * dx / count)
        cell[4] = rest * (cell[4] + dx * dy / count)
        cell[5] = rest * (cell[5] + dy * dy / count)


@compiled(
    "float64[::1](float32[:,:,:,::1], int32[:,::1], float64[:,::1], float64, float64, float64, float64, float64, "
    "float64, int64, float64, int64, float64)"
)
def align(
    tiles: NDArray[np.float32],
    table: NDArray[np.int32],
    points: NDArray[np.float64],
    x: float,
    y: float,
    theta: float,
    expected_x: float,
    expected_y: float,
    expected_theta: float,
    ratio: int,
    variance: float,
    iterations: int,
    pull: float,
) -> NDArray[np.float64]:
    """Move a pose to where the points are likeliest, by Gauss-Newton. Unit: fine cells.

    This differs from Biber and Strasser, sections III to VI, in three ways:

    - A point counts for the four cells around it, weighted bilinearly by the distance to their centres. This blends the
      four overlapping grids of the paper.
    - With V the covariance of a cell, the information of a point in it is adj V / (det V + `variance` tr V) instead of
      the inverse of V. For a wall this is 1 / (`variance` + its thickness squared) across the wall and nothing along
      it, where the inverse would pull towards the centre of the cell.
    - The optimisation is Gauss-Newton on the weighted squared distances instead of Newton on the score, and a prior
      holds the pose at the expected one where the walls leave a direction open.

    Args:
        tiles: Tiles of the map.
        table: Index of the tile at each place.
        points: (n, 2), frame of the robot.
        x: Start of the optimisation.
        y: Start of the optimisation.
        theta: Start of the optimisation, radians.
        expected_x: Mean of the prior.
        expected_y: Mean of the prior.
        expected_theta: Mean of the prior, radians.
        ratio: Fine cells along a coarse one.
        variance: Variance of a single measurement, square fine cells.
        iterations: Maximum number of iterations.
        pull: Information of the prior per point on known walls, per square fine cell.

    Returns:
        (9,) x, y, theta, and the upper triangle of the information matrix: xx, xy, xt, yy, yt, tt.
    """
    height, width = table.shape[0] << SHIFT, table.shape[1] << SHIFT
    count = points.shape[0]
    xx = xy = xt = yy = yt = tt = 0.0
    for _ in range(iterations):
        c, s = math.cos(theta), math.sin(theta)
        # Accumulate the information matrix H and the gradient g over all points. `known` is how many points, by
        # bilinear weight, lie in cells with a distribution.
        xx = yy = tt = xy = xt = yt = gx = gy = gt = known = 0.0
        for i in range(count):
            # Map the point into the frame of the map, in coarse cells, and find the four cells around it.
            rx = c * points[i, 0] - s * points[i, 1]
            ry = s * points[i, 0] + c * points[i, 1]
            u, v = (x + rx + 0.5) / ratio - 0.5, (y + ry + 0.5) / ratio - 0.5
            left, low = math.floor(u), math.floor(v)
            if not (0 <= left < width - 1 and 0 <= low < height - 1):
                continue
            u -= left
            v -= low
            for corner in range(4):
                column, row = corner & 1, corner >> 1
                tile, r, q = known_cell(tiles, table, left + column, low + row)
                if tile < 0:
                    continue
                cell = tiles[tile, r, q]
                # Error e: from the point to the mean of the cell.
                ex, ey = cell[1] - (u - column) * ratio, cell[2] - (v - row) * ratio
                # Information I = adj V / (det V + variance tr V).
                vxx, vxy, vyy = cell[3], cell[4], cell[5]
                scale = 1.0 / (vxx * vyy - vxy * vxy + variance * (vxx + vyy) + 1e-6)
                ixx, ixy, iyy = scale * vyy, -scale * vxy, scale * vxx
                px, py = ixx * ex + ixy * ey, ixy * ex + iyy * ey
                # Weight: the score exp(-e' I e / 2) of the paper, which makes outliers count little.
                share = (u if column else 1.0 - u) * (v if row else 1.0 - v)
                known += share
                weight = share * math.exp(-0.5 * (px * ex + py * ey))
                # Jacobian of the mapped point by x, y, theta: the identity and (-ry, rx). H += w J' I J, g += w J' I e.
                tx, ty = ixy * rx - ixx * ry, iyy * rx - ixy * ry
                xx += weight * ixx
                xy += weight * ixy
                yy += weight * iyy
                xt += weight * tx
                yt += weight * ty
                tt += weight * (rx * ty - ry * tx)
                gx += weight * px
                gy += weight * py
                gt += weight * (rx * py - ry * px)
        # Prior: the expected pose, with as much weight as the number of known points gives it.
        whole, turn_pull = pull * known + 1e-9, TURN_PULL * known + 1e-9
        xx, yy, tt = xx + whole, yy + whole, tt + turn_pull
        gx, gy = gx + whole * (expected_x - x), gy + whole * (expected_y - y)
        gt += turn_pull * (expected_theta - theta)
        # Solve H step = g by the adjugate of the symmetric 3 by 3 matrix.
        a, b, d = yy * tt - yt * yt, xt * yt - xy * tt, xy * yt - xt * yy
        e, f, g = xx * tt - xt * xt, xy * xt - xx * yt, xx * yy - xy * xy
        determinant = xx * a + xy * b + xt * d
        if determinant <= 0.0:
            break
        step_x = (a * gx + b * gy + d * gt) / determinant
        step_y = (b * gx + e * gy + f * gt) / determinant
        step_t = min(max((d * gx + f * gy + g * gt) / determinant, -TURN_LIMIT), TURN_LIMIT)
        # Limit the step to half a coarse cell: a distribution is valid only in its own cell.
        length = math.hypot(step_x, step_y)
        shrink = min(1.0, 0.5 * ratio / max(length, 1e-9))
        x, y, theta = x + shrink * step_x, y + shrink * step_y, theta + step_t
        if length < MOVE_TOLERANCE and abs(step_t) < TURN_TOLERANCE:
            break
    return np.array([x, y, theta, xx, xy, xt, yy, yt, tt])
