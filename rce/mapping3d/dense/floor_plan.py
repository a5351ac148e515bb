"""The occupancy grid for navigation, cut from the surface and from the rays that saw it."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from rce.mapping.grid import UNKNOWN, OccupancyGrid
from rce.mapping.matching.kernels import compiled
from rce.mapping3d.dense.mesh import Vertices
from rce.mapping3d.poses import Pose, transform

STEP_HEIGHT = 0.1  # metres: what is lower belongs to the floor
LOW_RAY = 0.4  # metres: a ray that is higher says little about what stands below it
MIN_POINTS = 3  # of the surface in a cell that is occupied
FREE, OCCUPIED = 0, 100


def cut(
    surface: Vertices, views: Iterable[tuple[Pose, Vertices]], resolution: float, robot_height: float
) -> OccupancyGrid:
    """Return the floor plan.

    A cell is occupied if the surface passes it between the floor and the height of the robot. Otherwise it is free if a
    ray passed it close to the floor or hit the floor there. OctoMap's server projects its map like this (Hornung et
    al., 2013), but from rays of any height, and so declares free what nobody has seen behind the edge of a table.

    Args:
        surface: (n, 3) points, metres, level frame.
        views: The pose of each camera, camera to level frame, and the points (k, 3) that it saw, its frame.
        resolution: Metres per cell.
        robot_height: Metres.
    """
    seen = [(pose[:3, 3], transform(pose, points)) for pose, points in views]
    everything = np.concatenate([surface[:, :2], *(np.vstack([eye, points])[:, :2] for eye, points in seen)])
    if not len(everything):
        return OccupancyGrid(np.full((1, 1), UNKNOWN, np.int8), resolution, 0.0, 0.0)
    corner = np.floor(everything.min(axis=0) / resolution) - 1
    columns, rows = (np.floor(everything.max(axis=0) / resolution) - corner + 2).astype(np.int64).tolist()
    cells = np.full((rows, columns), UNKNOWN, np.int8)
    x, y = (corner * resolution).tolist()
    for eye, points in seen:
        free_rays(cells, eye - [x, y, 0.0], points - [x, y, 0.0], resolution)
    solid = surface[(surface[:, 2] > STEP_HEIGHT) & (surface[:, 2] < robot_height), :2]
    places = np.floor(solid / resolution - corner).astype(np.int64)
    hits = np.bincount(places[:, 1] * columns + places[:, 0], minlength=cells.size).reshape(cells.shape)
    cells[hits >= MIN_POINTS] = OCCUPIED
    return OccupancyGrid(cells, resolution, x, y)


@compiled("void(int8[:,::1], float64[::1], float64[:,::1], float64)")
def free_rays(
    cells: NDArray[np.int8], eye: NDArray[np.float64], points: NDArray[np.float64], resolution: float
) -> None:
    """Set the cells to free that rays pass close to the floor; a cell that is hit only if it is floor.

    Args:
        cells: (height, width), changed in place; its corner is the origin.
        eye: (3,) where the rays begin, metres.
        points: (n, 3) where they end, metres.
        resolution: Metres per cell.
    """
    for i in range(points.shape[0]):
        x, y, z = points[i, 0] - eye[0], points[i, 1] - eye[1], points[i, 2] - eye[2]
        length = math.sqrt(x * x + y * y)
        steps = int(2.0 * length / resolution) + 1
        for step in range(steps + 1):
            share = step / steps
            height = eye[2] + share * z
            if height > LOW_RAY or height < -STEP_HEIGHT:
                continue
            if points[i, 2] > STEP_HEIGHT and (1.0 - share) * length < 1.5 * resolution:
                break
            cells[int((eye[1] + share * y) / resolution), int((eye[0] + share * x) / resolution)] = FREE
