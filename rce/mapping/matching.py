"""Finding the pose at which a scan fits the map: exhaustive search, coarse, then climbing on the likelihood field."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping import kernels
from rce.mapping.geometry import Points, Pose, wrap_angle
from rce.mapping.grid import GridMap

STRIDE = 0.1  # metres between places of the search: the likelihood reaches from one to the next
TURN = math.radians(1.5)
SEARCH_POINTS = 150  # more make the search slower, not better
MOVE_COST, TURN_COST = 0.3, 0.3  # of leaving the prediction, per square metre and square radian, in mean likelihood
ITERATIONS = 20


@dataclass(frozen=True, slots=True)
class Window:
    """What the search covers on each side of a predicted pose: metres along x and y, radians."""

    reach: float
    turn: float


@dataclass(frozen=True, slots=True)
class Match:
    """`pose` of the robot in the map frame, `score`: mean likelihood of the points there (0..1), `covariance`: (3, 3)
    of x, y, theta in square metres and radians."""

    pose: Pose
    score: float
    covariance: NDArray[np.float64]


def match(grid: GridMap, points: Points, predictions: list[Pose], window: Window) -> Match:
    """The pose around one of the predictions at which the points (n, 2), metres, frame of the robot, fit best."""
    resolution = grid.resolution
    cells = points / resolution
    thinned = np.ascontiguousarray(cells[:: max(1, len(cells) // SEARCH_POINTS)])
    stride = max(1, round(STRIDE / resolution))
    steps, turns = round(window.reach / (stride * resolution)), round(window.turn / TURN)
    best, start = -math.inf, predictions[0]
    for prediction in predictions:
        x, y, theta, score = kernels.correlate(
            grid.likelihood,
            thinned,
            *grid.pose_to_cells(prediction),
            stride,
            steps,
            turns,
            TURN,
            MOVE_COST * resolution**2,
            TURN_COST,
        )
        if score > best:
            best, start = score, Pose(x, y, theta)
    x, y, theta, score, *information = kernels.refine(grid.likelihood, cells, *start, ITERATIONS).tolist()
    pose = grid.pose_from_cells(Pose(x, y, wrap_angle(theta)))
    return Match(pose, score, _covariance(information, score, resolution))


def _covariance(information: list[float], score: float, resolution: float) -> NDArray[np.float64]:
    """Inverse of the information matrix, scaled by the mean residual of the match, in metres and radians."""
    xx, xy, xt, yy, yt, tt = information
    matrix = np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])
    scale = np.array([resolution, resolution, 1.0])
    return np.linalg.inv(matrix) * (1.0 - score) * np.outer(scale, scale)
