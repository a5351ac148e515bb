"""The direction of gravity and the floor, from a surface: the first pose of a hand-held camera is tilted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rce.mapping3d.dense.mesh import Cloud
from rce.mapping3d.poses import Pose, make_pose

TOLERANCES = (45.0, 20.0, 10.0, 5.0)  # degrees, from coarse to fine
ROUNDS = 3  # for each tolerance
BIN = 0.02  # metres of height
SHARE = 0.1  # of the largest level surface that the floor must have

Floats = NDArray[np.float64]


def find_level(cloud: Cloud, poses: Sequence[Pose]) -> Pose:
    """Return the pose that takes points of the map to the level frame.

    Its z axis points up, its x axis along the view of the first camera. Its origin is on the floor below that camera,
    or on the lowest level surface where no floor is seen.

    Args:
        cloud: The surface, map frame.
        poses: Of the cameras, camera to map; at least one. Their upper edges are up, within 45° on average.
    """
    up = find_up(cloud.normals.astype(np.float64), -np.mean([pose[:3, 1] for pose in poses], axis=0))
    first = poses[0]
    ahead = first[:3, 2] - up * (up @ first[:3, 2])
    if np.linalg.norm(ahead) < 0.1:  # it looks straight up or down: its upper edge is ahead or behind
        ahead = -first[:3, 1] + up * (up @ first[:3, 1])
    ahead /= np.linalg.norm(ahead)
    rotation = np.stack([ahead, np.cross(up, ahead), up])
    origin = rotation @ first[:3, 3]
    origin[2] = find_floor(cloud, up) if len(cloud.points) else origin[2]
    return make_pose(rotation, -origin)


def find_up(normals: Floats, guess: Floats) -> Floats:
    """Return the unit vector to which most surfaces are perpendicular or parallel.

    Gupta, Arbelaez and Malik, Perceptual Organization and Recognition of Indoor Scenes from RGB-D Images, 2013, section
    3.2: normals close to the axis pull it to themselves, those across push it away.

    Args:
        normals: (n, 3), unit vectors, or zeros, which count nothing.
        guess: (3,), closer to up than 45°.
    """
    up = guess / np.linalg.norm(guess)
    for tolerance in np.radians(TOLERANCES):
        for _ in range(ROUNDS):
            along = np.abs(normals @ up)
            across = normals[(along < np.sin(tolerance))]
            level = normals[along > np.cos(tolerance)]
            if not len(level) and len(across) < 2:
                return up
            axis: Floats = np.linalg.eigh(across.T @ across - level.T @ level)[1][:, 0]
            up = axis if axis @ up > 0 else -axis
    return up


def find_floor(cloud: Cloud, up: Floats) -> float:
    """Return the height of the floor, metres along `up` (3,): of the lowest surface that is level and large."""
    level = cloud.normals @ up > 0.9
    heights = cloud.points[level].astype(np.float64) @ up
    if not len(heights):
        return float((cloud.points @ up).min())
    low = heights.min() - BIN
    counts = np.bincount(((heights - low) / BIN).astype(np.int64), minlength=3)
    counts = np.convolve(np.append(counts, 0), [1, 1, 1], "same")
    place = int(np.argmax(counts >= SHARE * counts.max()))
    while place + 1 < len(counts) and counts[place + 1] > counts[place]:
        place += 1
    centre = low + (place + 0.5) * BIN
    return float(np.median(heights[np.abs(heights - centre) < 2 * BIN]))
