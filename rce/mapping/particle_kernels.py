"""The inner loops of the particle filter. Unit: fine cells, radians; frame: as in `tiles.TileMaps.to_cells`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rce.mapping import ndt
from rce.mapping.kernels import compiled

OUTLIER = 0.1  # likelihood of a beam that ends where nothing is known, on a wall: 1
NOBODY = 0
FEW = 60  # points with which is looked around
STEPS, TURNS, TURN = 2, 2, math.radians(2)  # cells and angles to each side


@compiled("boolean(float32[:,:,:,::1], int32[:,:,::1], int32[::1], float64[:,::1], float64[:,::1], int64)")
def claim(
    tiles: NDArray[np.float32],
    tables: NDArray[np.int32],
    users: NDArray[np.int32],
    poses: NDArray[np.float64],
    points: NDArray[np.float64],
    ratio: int,
) -> bool:
    """Give each map a tile of its own, copied if there was one, where its points lie. False if there are not enough
    tiles: then it may be called again with more."""
    free = 0
    for k in range(poses.shape[0]):
        table = tables[k]
        c, s = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        for i in range(points.shape[0]):
            x = poses[k, 0] + c * points[i, 0] - s * points[i, 1]
            y = poses[k, 1] + s * points[i, 0] + c * points[i, 1]
            column = math.floor((x + 0.5) / ratio) >> ndt.SHIFT
            row = math.floor((y + 0.5) / ratio) >> ndt.SHIFT
            if not (0 <= column < table.shape[1] and 0 <= row < table.shape[0]):
                continue
            old = table[row, column]
            if old >= 0 and users[old] == 1:
                continue
            while free < users.shape[0] and users[free] != NOBODY:
                free += 1
            if free == users.shape[0]:
                return False
            if old >= 0:
                tiles[free] = tiles[old]
                users[old] -= 1
            else:
                tiles[free] = 0.0
            users[free] = 1
            table[row, column] = free
    return True


@compiled("void(float32[:,:,:,::1], int32[:,:,::1], float64[:,::1], float64[:,::1], int64, int64, int64)")
def learn(
    tiles: NDArray[np.float32],
    tables: NDArray[np.int32],
    poses: NDArray[np.float64],
    points: NDArray[np.float64],
    ratio: int,
    begin: int,
    end: int,
) -> None:
    """Enter the points in maps `begin` to `end`, each from its pose."""
    hits = np.empty_like(points)
    for k in range(begin, end):
        c, s = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        for i in range(points.shape[0]):
            hits[i, 0] = poses[k, 0] + c * points[i, 0] - s * points[i, 1]
            hits[i, 1] = poses[k, 1] + s * points[i, 0] + c * points[i, 1]
        ndt.learn(tiles, tables[k], hits, ratio)


@compiled("float64(float32[:,:,:,::1], int32[:,::1], float64[:,::1], float64, float64, float64, int64, float64)")
def log_likelihood(
    tiles: NDArray[np.float32],
    table: NDArray[np.int32],
    points: NDArray[np.float64],
    x: float,
    y: float,
    theta: float,
    ratio: int,
    variance: float,
) -> float:
    """Sum over the points of the logarithm of their likelihood: across a wall with a spread that is that of the
    measurement (`variance`) and its own, so that a wall which has become thick explains less."""
    height, width = table.shape[0] << ndt.SHIFT, table.shape[1] << ndt.SHIFT
    c, s = math.cos(theta), math.sin(theta)
    total = 0.0
    for i in range(points.shape[0]):
        u = (x + c * points[i, 0] - s * points[i, 1] + 0.5) / ratio - 0.5
        v = (y + s * points[i, 0] + c * points[i, 1] + 0.5) / ratio - 0.5
        left, low = math.floor(u), math.floor(v)
        likelihood = 0.0
        if 0 <= left < width - 1 and 0 <= low < height - 1:
            u -= left
            v -= low
            for corner in range(4):
                column, row = corner & 1, corner >> 1
                tile = table[low + row >> ndt.SHIFT, left + column >> ndt.SHIFT]
                if tile < 0:
                    continue
                cell = tiles[tile, low + row & ndt.TILE - 1, left + column & ndt.TILE - 1]
                if cell[0] < ndt.FEWEST_HITS:
                    continue
                ex, ey = cell[1] - (u - column) * ratio, cell[2] - (v - row) * ratio
                vxx, vxy, vyy = cell[3], cell[4], cell[5]
                determinant, trace = vxx * vyy - vxy * vxy, vxx + vyy
                scale = 1.0 / (determinant + variance * trace + 1e-6)
                squared = scale * (vyy * ex * ex - 2.0 * vxy * ex * ey + vxx * ey * ey)
                thick = max(determinant, 0.0) / (trace + 1e-6)  # variance across the wall
                share = (u if column else 1.0 - u) * (v if row else 1.0 - v)
                likelihood += share * math.sqrt(variance / (variance + thick)) * math.exp(-0.5 * squared)
        total += math.log(OUTLIER + (1.0 - OUTLIER) * likelihood)
    return total


@compiled(
    "Tuple((float64, float64, float64, float64))(float32[:,:,:,::1], int32[:,::1], float64[:,::1], float64[::1], "
    "int64, float64)"
)
def look_around(
    tiles: NDArray[np.float32],
    table: NDArray[np.int32],
    points: NDArray[np.float64],
    centre: NDArray[np.float64],
    ratio: int,
    variance: float,
) -> tuple[float, float, float, float]:
    """The likeliest pose on a lattice around a pose, one place a cell, and the log-likelihood of the points there."""
    best, best_x, best_y, best_theta = -1e30, centre[0], centre[1], centre[2]
    for a in range(-TURNS, TURNS + 1):
        theta = centre[2] + a * TURN
        for v in range(-STEPS, STEPS + 1):
            for u in range(-STEPS, STEPS + 1):
                x, y = centre[0] + u * ratio, centre[1] + v * ratio
                found = log_likelihood(tiles, table, points, x, y, theta, ratio, variance)
                if found > best:
                    best, best_x, best_y, best_theta = found, x, y, theta
    return best_x, best_y, best_theta, best


@compiled(
    "void(float32[:,:,:,::1], int32[:,:,::1], float64[:,::1], float64[:,::1], float64[:,::1], float64[:,::1], "
    "int64, float64, int64, float64, int64, int64)"
)
def match(
    tiles: NDArray[np.float32],
    tables: NDArray[np.int32],
    points: NDArray[np.float64],
    starts: NDArray[np.float64],
    expected: NDArray[np.float64],
    found: NDArray[np.float64],
    ratio: int,
    variance: float,
    iterations: int,
    jump: float,
    begin: int,
    end: int,
) -> None:
    """For maps `begin` to `end`: write to `found` (n, 11) the likeliest pose of the points near its start, with the
    information about it (as `ndt.align`), the log-likelihood there, and 0.

    Where some pose around is so much likelier that the logarithm exceeds it by `jump`, that pose and 1 instead.
    """
    few = np.ascontiguousarray(points[:: max(1, points.shape[0] // FEW)])
    share = points.shape[0] / few.shape[0]
    for k in range(begin, end):
        table = tables[k]
        e = expected[k]
        found[k, :9] = ndt.align(
            tiles,
            table,
            points,
            starts[k, 0],
            starts[k, 1],
            starts[k, 2],
            e[0],
            e[1],
            e[2],
            ratio,
            variance,
            iterations,
            ndt.PULL,
        )
        x, y, theta = found[k, 0], found[k, 1], found[k, 2]
        found[k, 9] = log_likelihood(tiles, table, points, x, y, theta, ratio, variance)
        found[k, 10] = 0.0
        here = log_likelihood(tiles, table, few, x, y, theta, ratio, variance)
        x, y, theta, there = look_around(tiles, table, few, e, ratio, variance)
        if share * (there - here) <= 0.5 * jump:
            continue
        other = ndt.align(tiles, table, points, x, y, theta, x, y, theta, ratio, variance, iterations, ndt.PULL)
        likelihood = log_likelihood(tiles, table, points, other[0], other[1], other[2], ratio, variance)
        if likelihood > found[k, 9] + jump:
            found[k, :9] = other
            found[k, 9], found[k, 10] = likelihood, 1.0
