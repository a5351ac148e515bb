"""Compiled inner loops of the particle filter.

Unit: fine cells and radians; frame: as returned by `tiles.TileMaps.to_cells`. The loops over particles take a range of
them, so that threads can share the work.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.matching import ndt
from rce.mapping.matching.kernels import compiled


@dataclass(frozen=True, slots=True)
class MeasurementSettings:
    """Settings of the measurement model and of the search around the expected pose.

    Attributes:
        outlier: Likelihood of a beam that ends where no wall is known; that of a beam on a wall is 1.
        search_points: Points with which the lattice is searched; the pose that it finds is scored with all points.
        steps: Positions on each side of the expected one along x and y, a coarse cell apart.
        turns: Angles on each side of the expected one.
        turn: Radians between angles.
    """

    outlier: float = 0.1
    search_points: int = 60
    steps: int = 2
    turns: int = 2
    turn: float = math.radians(2)


SETTINGS = MeasurementSettings()
# Kernels take plain numbers; Numba compiles these in as constants.
OUTLIER, SEARCH_POINTS = SETTINGS.outlier, SETTINGS.search_points
STEPS, TURNS, TURN = SETTINGS.steps, SETTINGS.turns, SETTINGS.turn
UNUSED = 0  # number of users of a free tile


@compiled("boolean(float32[:,:,:,::1], int32[:,:,::1], int32[::1], float64[:,::1], float64[:,::1], int64)")
def unshare(
    tiles: NDArray[np.float32],
    tables: NDArray[np.int32],
    users: NDArray[np.int32],
    poses: NDArray[np.float64],
    points: NDArray[np.float64],
    ratio: int,
) -> bool:
    """Give each map its own tiles where its points lie, copied from the shared tiles.

    Args:
        tiles: Tiles of all maps, changed in place.
        tables: (count, rows, columns) index of the tile at each place of each map, changed in place.
        users: Number of maps that have each tile, changed in place.
        poses: (count, 3) pose of the robot in each map.
        points: (n, 2), frame of the robot.
        ratio: Fine cells along a coarse one.

    Returns:
        False if there are not enough tiles: the call may be repeated with more of them.
    """
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
            # A tile that no other map has may be changed as it is.
            old = table[row, column]
            if old >= 0 and users[old] == 1:
                continue
            # Else take the next free tile, as a copy of the shared one or empty.
            while free < users.shape[0] and users[free] != UNUSED:
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
    """Add points to maps `begin` to `end`, each from its pose.

    Args:
        tiles: Tiles of all maps, changed in place. The tiles that are changed must not be shared; see `unshare`.
        tables: (count, rows, columns) index of the tile at each place of each map.
        poses: (count, 3) pose of the robot in each map.
        points: (n, 2), frame of the robot.
        ratio: Fine cells along a coarse one.
        begin: First map.
        end: Last map, exclusive.
    """
    hits = np.empty_like(points)
    for k in range(begin, end):
        c, s = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        for i in range(points.shape[0]):
            hits[i, 0] = poses[k, 0] + c * points[i, 0] - s * points[i, 1]
            hits[i, 1] = poses[k, 1] + s * points[i, 0] + c * points[i, 1]
        ndt.learn(tiles, tables[k], hits, ratio)


@compiled(
    "float64(float32[:,:,:,::1], int32[:,::1], float64[:,::1], float64, float64, float64, int64, float64, float64)"
)
def log_likelihood(
    tiles: NDArray[np.float32],
    table: NDArray[np.int32],
    points: NDArray[np.float64],
    x: float,
    y: float,
    theta: float,
    ratio: int,
    variance: float,
    least: float,
) -> float:
    """Return the sum over the points of the logarithm of their likelihood, or less than `least` if it is less.

    The likelihood of a point is that of the NDT score (Biber and Strasser, 2003), mixed with a constant for outliers.
    Across a wall its variance is that of the measurement and that of the wall itself, and the density is normalised: a
    wall that has become thick explains less.

    Args:
        tiles: Tiles of all maps.
        table: Index of the tile at each place of the map.
        points: (n, 2), frame of the robot.
        x: Pose of the robot.
        y: Pose of the robot.
        theta: Pose of the robot.
        ratio: Fine cells along a coarse one.
        variance: Variance of a single measurement, square fine cells.
        least: Sum below which the exact one does not matter. No point adds to the sum, so the rest is skipped.
    """
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
                tile, r, q = ndt.known_cell(tiles, table, left + column, low + row)
                if tile < 0:
                    continue
                cell = tiles[tile, r, q]
                # Squared Mahalanobis distance e' I e with the information I of `ndt.align`.
                ex, ey = cell[1] - (u - column) * ratio, cell[2] - (v - row) * ratio
                vxx, vxy, vyy = cell[3], cell[4], cell[5]
                determinant, trace = vxx * vyy - vxy * vxy, vxx + vyy
                scale = 1.0 / (determinant + variance * trace + 1e-6)
                squared = scale * (vyy * ex * ex - 2.0 * vxy * ex * ey + vxx * ey * ey)
                thick = max(determinant, 0.0) / (trace + 1e-6)  # variance across the wall
                share = (u if column else 1.0 - u) * (v if row else 1.0 - v)
                likelihood += share * math.sqrt(variance / (variance + thick)) * math.exp(-0.5 * squared)
        # Mixture with the outliers; the points count as independent.
        total += math.log(OUTLIER + (1.0 - OUTLIER) * likelihood)
        if total < least:
            break
    return total


@compiled(
    "Tuple((float64, float64, float64, float64))(float32[:,:,:,::1], int32[:,::1], float64[:,::1], float64[::1], "
    "int64, float64, float64)"
)
def search_lattice(
    tiles: NDArray[np.float32],
    table: NDArray[np.int32],
    points: NDArray[np.float64],
    centre: NDArray[np.float64],
    ratio: int,
    variance: float,
    least: float,
) -> tuple[float, float, float, float]:
    """Return the likeliest pose on a lattice around a pose, one position a coarse cell, and the log-likelihood there.

    If no pose is likelier than `least`, it returns the centre and `least`.

    Args:
        tiles: Tiles of all maps.
        table: Index of the tile at each place of the map.
        points: (n, 2), frame of the robot.
        centre: (3,) centre of the lattice.
        ratio: Fine cells along a coarse one.
        variance: Variance of a single measurement, square fine cells.
        least: Log-likelihood of a pose that counts.
    """
    best, best_x, best_y, best_theta = least, centre[0], centre[1], centre[2]
    for a in range(-TURNS, TURNS + 1):
        theta = centre[2] + a * TURN
        for v in range(-STEPS, STEPS + 1):
            for u in range(-STEPS, STEPS + 1):
                x, y = centre[0] + u * ratio, centre[1] + v * ratio
                found = log_likelihood(tiles, table, points, x, y, theta, ratio, variance, best)
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
    """Match points with maps `begin` to `end`.

    Args:
        tiles: Tiles of all maps.
        tables: (count, rows, columns) index of the tile at each place of each map.
        points: (n, 2), frame of the robot.
        starts: (count, 3) starts of the optimisations.
        expected: (count, 3) poses that the motion predicts.
        found: (count, 11) result, changed in place: x, y, theta, the upper triangle of the information matrix (see
            `ndt.align`), the log-likelihood at the pose, and 1 if the pose is a jump, else 0.
        ratio: Fine cells along a coarse one.
        variance: Variance of a single measurement, square fine cells.
        iterations: Maximum number of iterations of each optimisation.
        jump: Log-likelihood by which a pose around the expected one has to exceed the fitted pose to replace it.
        begin: First map.
        end: Last map, exclusive.
    """
    few = np.ascontiguousarray(points[:: max(1, points.shape[0] // SEARCH_POINTS)])
    share = points.shape[0] / few.shape[0]
    for k in range(begin, end):
        table = tables[k]
        e = expected[k]
        # Scan matching: fit the points, starting from the sampled motion.
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
        found[k, 9] = log_likelihood(tiles, table, points, x, y, theta, ratio, variance, -math.inf)
        found[k, 10] = 0.0
        # Look for a jump with few points. The lattice is coarse, so half of the required difference suffices here.
        here = log_likelihood(tiles, table, few, x, y, theta, ratio, variance, -math.inf)
        least = here + 0.5 * jump / share
        x, y, theta, there = search_lattice(tiles, table, few, e, ratio, variance, least)
        if there <= least:
            continue
        # Fit from the best pose of the lattice, and decide with all points.
        other = ndt.align(tiles, table, points, x, y, theta, x, y, theta, ratio, variance, iterations, ndt.PULL)
        likelihood = log_likelihood(tiles, table, points, other[0], other[1], other[2], ratio, variance, -math.inf)
        if likelihood > found[k, 9] + jump:
            found[k, :9] = other
            found[k, 9], found[k, 10] = likelihood, 1.0
