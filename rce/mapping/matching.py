"""Finding the pose at which a scan fits the walls around: exhaustive search on a coarse lattice, then fitting."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping import kernels, ndt
from rce.mapping.fields import Field
from rce.mapping.geometry import Points, Pose, wrap_angle

STRIDE = 0.1  # metres between places of the search: the likelihood reaches from one to the next
TURN = math.radians(1.5)
SEARCH_POINTS = 150  # more make the search slower, not better
MOVE_COST, TURN_COST = 0.3, 0.3  # of leaving the prediction, per square metre and square radian, in mean likelihood
DISTRUST = 0.05  # by how much a place around a later prediction must be likelier than one around an earlier one
NOISE = 0.04  # metres; of a single measured point, with what the motion during the sweep adds
ITERATIONS = 20


@dataclass(frozen=True, slots=True)
class Window:
    """What the search covers on each side of a predicted pose: metres along x and y, radians."""

    reach: float
    turn: float


@dataclass(frozen=True, slots=True)
class Match:
    """`pose` of the robot in the map frame, `score`: mean likelihood of the points (0..1) in the search,
    `covariance`: (3, 3) of x, y, theta in square metres and radians, as if the points were independent."""

    pose: Pose
    score: float
    covariance: NDArray[np.float64]


def match(field: Field, points: Points, predictions: list[Pose], window: Window) -> Match:
    """The pose around one of the predictions at which the points (n, 2), metres, frame of the robot, fit best.

    The predictions come with the most trusted first.
    """
    cells = points / field.resolution
    start, score = _search(field, cells, predictions, window)
    variance = (NOISE / field.resolution) ** 2
    fitted = ndt.align(field.normals, cells, *start, field.ratio, variance, ITERATIONS).tolist()
    x, y, theta, *information = fitted
    pose = field.pose_from_cells(Pose(x, y, wrap_angle(theta)))
    return Match(pose, score, covariance_of(information, field.resolution))


def _search(field: Field, cells: Points, predictions: list[Pose], window: Window) -> tuple[Pose, float]:
    """The best pose of the lattices around the predictions, in cells, and its score."""
    thinned = np.ascontiguousarray(cells[:: max(1, len(cells) // SEARCH_POINTS)])
    stride = max(1, round(STRIDE / field.resolution))
    steps, turns = round(window.reach / (stride * field.resolution)), round(window.turn / TURN)
    move_cost = MOVE_COST * field.resolution**2
    found = [
        kernels.correlate(
            field.likelihood,
            thinned,
            *field.pose_to_cells(prediction),
            stride,
            steps,
            turns,
            TURN,
            move_cost,
            TURN_COST,
        )
        for prediction in predictions
    ]
    best = max(range(len(found)), key=lambda i: found[i][3] - DISTRUST * i)
    x, y, theta, score = found[best]
    return Pose(x, y, theta), score


def covariance_of(information: list[float], resolution: float) -> NDArray[np.float64]:
    """Inverse of the information matrix (upper triangle, cells), in metres and radians."""
    xx, xy, xt, yy, yt, tt = information
    matrix = np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])
    scale = np.array([resolution, resolution, 1.0])
    covariance: NDArray[np.float64] = np.linalg.inv(matrix) * np.outer(scale, scale)
    return covariance
