"""Normal distributions of the points that were measured, and fitting scans to them.

Biber and Strasser, The Normal Distributions Transform: A New Approach to Laser Scan Matching (2003). The map is cut in
coarse cells; each holds mean and covariance of the hits in it. Since they average over all scans, a wall stays as sharp
as the sensor sees it, however often it is seen.

The cells are stored in tiles of TILE by TILE, `tiles` (n, TILE, TILE, FIELDS) float32, and `table` (rows, columns)
int32 says which tile lies where in the map, -1 where there is none. So several maps may share tiles.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rce.mapping.kernels import compiled

FIELDS = 6  # of a cell: count, mean x, mean y (from its centre), covariance xx, xy, yy; in fine cells
SHIFT = 4
TILE = 1 << SHIFT  # cells along each side of a tile
FEWEST_HITS = 3.0  # a cell with fewer says nothing
MOST_HITS = 100.0  # that a cell remembers, so that it can follow changes
# Of the expected pose, per point on known walls: decides where the walls leave a direction open.
PULL, TURN_PULL = 1e-3, 1e-2


@compiled("void(float32[:,:,:,::1], int32[:,::1], float64[:,::1], int64)")
def learn(tiles: NDArray[np.float32], table: NDArray[np.int32], hits: NDArray[np.float64], ratio: int) -> None:
    """Enter hits (n, 2), fine cells, in cells that are `ratio` fine cells wide. Those where no tile is are ignored."""
    height, width = table.shape[0] << SHIFT, table.shape[1] << SHIFT
    for i in range(hits.shape[0]):
        x, y = (hits[i, 0] + 0.5) / ratio - 0.5, (hits[i, 1] + 0.5) / ratio - 0.5
        column, row = math.floor(x + 0.5), math.floor(y + 0.5)
        if not (0 <= column < width and 0 <= row < height):
            continue
        tile = table[row >> SHIFT, column >> SHIFT]
        if tile < 0:
            continue
        cell = tiles[tile, row & TILE - 1, column & TILE - 1]
        count = min(cell[0] + 1.0, MOST_HITS)
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
    """Move from (x, y, theta) to where the points (n, 2), frame of the robot, are likeliest, by Gauss-Newton.

    Where the walls leave a direction open, as those of a corridor do, the expected pose decides: it counts as much as
    `pull` (information per square fine cell) for each point on known walls.
    A point counts for the four cells around it by its distance to their centres (the four overlapping grids of the
    paper, blended). With V the covariance of a cell, its weight is adj V / (det V + `variance` tr V): for a wall that
    is 1 / (`variance` + its thickness squared) across and nothing along it, where the inverse of V, which the paper
    takes, would pull towards the centre of the cell. `variance`: of a single measurement, in square fine cells.
    Returns x, y, theta and the upper triangle of the information matrix: xx, xy, xt, yy, yt, tt. Unit: fine cells.
    """
    height, width = table.shape[0] << SHIFT, table.shape[1] << SHIFT
    count = points.shape[0]
    xx = xy = xt = yy = yt = tt = 0.0
    for _ in range(iterations):
        c, s = math.cos(theta), math.sin(theta)
        xx = yy = tt = xy = xt = yt = gx = gy = gt = known = 0.0
        for i in range(count):
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
                tile = table[low + row >> SHIFT, left + column >> SHIFT]
                if tile < 0:
                    continue
                cell = tiles[tile, low + row & TILE - 1, left + column & TILE - 1]
                if cell[0] < FEWEST_HITS:
                    continue
                ex, ey = cell[1] - (u - column) * ratio, cell[2] - (v - row) * ratio
                vxx, vxy, vyy = cell[3], cell[4], cell[5]
                scale = 1.0 / (vxx * vyy - vxy * vxy + variance * (vxx + vyy) + 1e-6)
                ixx, ixy, iyy = scale * vyy, -scale * vxy, scale * vxx
                px, py = ixx * ex + ixy * ey, ixy * ex + iyy * ey
                share = (u if column else 1.0 - u) * (v if row else 1.0 - v)
                known += share
                weight = share * math.exp(-0.5 * (px * ex + py * ey))
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
        whole, turn_pull = pull * known + 1e-9, TURN_PULL * known + 1e-9
        xx, yy, tt = xx + whole, yy + whole, tt + turn_pull
        gx, gy = gx + whole * (expected_x - x), gy + whole * (expected_y - y)
        gt += turn_pull * (expected_theta - theta)
        a, b, d = yy * tt - yt * yt, xt * yt - xy * tt, xy * yt - xt * yy
        e, f, g = xx * tt - xt * xt, xy * xt - xx * yt, xx * yy - xy * xy
        determinant = xx * a + xy * b + xt * d
        if determinant <= 0.0:
            break
        step_x = (a * gx + b * gy + d * gt) / determinant
        step_y = (b * gx + e * gy + f * gt) / determinant
        step_t = min(max((d * gx + f * gy + g * gt) / determinant, -0.05), 0.05)
        length = math.hypot(step_x, step_y)
        shrink = min(1.0, 0.5 * ratio / max(length, 1e-9))  # a cell says nothing about what is further off
        x, y, theta = x + shrink * step_x, y + shrink * step_y, theta + step_t
        if length < 2e-3 and abs(step_t) < 1e-5:
            break
    return np.array([x, y, theta, xx, xy, xt, yy, yt, tt])
