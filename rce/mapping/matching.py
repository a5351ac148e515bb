"""Finding the pose at which a scan fits the walls around: fitting, and searching where that is not enough."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping import kernels, ndt
from rce.mapping.fields import Field
from rce.mapping.geometry import Points, Pose, wrap_angle

SURE = 0.9  # score of a fitted prediction from which on nothing else is searched
STRIDE = 0.1  # metres between places of the search: the likelihood reaches from one to the next
TURN = math.radians(1.5)
SEARCH_POINTS = 150  # more make the search slower, not better
DISTRUST = 0.05  # by how much a place around a later prediction must be likelier than one around an earlier one
PREFERENCE = 0.02  # by how much a pose that was searched for must be likelier than the fitted prediction
WORSE = 0.02  # by how much fitting may lower the score; more means that there was too little to fit to
NOISE = 0.04  # metres; of a single measured point, with what the motion during the sweep adds
ITERATIONS = 20
TRUST = 0.004  # metres of spread with which one point says as much about a direction as the prediction


@dataclass(frozen=True, slots=True)
class Window:
    """What the search covers on each side of a predicted pose: metres along x and y, radians. `move_cost` and
    `turn_cost`: of leaving the prediction, per square metre and square radian, in mean likelihood."""

    reach: float
    turn: float
    move_cost: float = 0.3
    turn_cost: float = 0.3


@dataclass(frozen=True, slots=True)
class Match:
    """`pose` of the robot in the map frame, `score`: mean likelihood of the points there (0..1),
    `covariance`: (3, 3) of x, y, theta in square metres and radians, as if the points were independent. `sure`: no
    other place is nearly as likely, so far as was searched; the covariance covers those that are."""

    pose: Pose
    score: float
    covariance: NDArray[np.float64]
    sure: bool = True


def match(field: Field, points: Points, predictions: list[Pose], window: Window, spread: float = math.inf) -> Match:
    """The pose around one of the predictions at which the points (n, 2), metres, frame of the robot, fit best.

    The predictions come with the most trusted first. Where many points show what is not in the field yet, a wrong pose
    may seem as likely as the right one: what fits next to the first prediction is taken unless there is much better.
    `spread`: metres by which the first prediction is off, if things are as usual; in a corridor, where a few points
    that belong to no wall would lead along it, this is what holds the pose.
    """
    cells = points / field.resolution
    thinned = np.ascontiguousarray(cells[:: max(1, len(cells) // SEARCH_POINTS)])
    centres = [field.pose_to_cells(prediction) for prediction in predictions]
    pull = max(ndt.PULL, (TRUST / spread) ** 2)
    expected = fit(field, cells, thinned, centres[0], centres[0], pull)
    if expected.score >= SURE:
        return expected
    start, centre = _search(field, thinned, centres, window)
    found = fit(field, cells, thinned, start, centre)
    return found if found.score > expected.score + PREFERENCE else expected


def fit(field: Field, cells: Points, thinned: Points, start: Pose, expected: Pose, pull: float = ndt.PULL) -> Match:
    """Fit points to the normal distributions, and score some of them; everything but the answer is in cells. `pull`:
    of the expected pose, see `ndt.align`."""
    variance = (NOISE / field.resolution) ** 2
    fitted = ndt.align(field.tiles, field.table, cells, *start, *expected, field.ratio, variance, ITERATIONS, pull)
    x, y, theta, *information = fitted.tolist()
    score, before = _score(field, thinned, Pose(x, y, theta)), _score(field, thinned, start)
    if score < before - WORSE:
        (x, y, theta), score = start, before
    pose = field.pose_from_cells(Pose(x, y, wrap_angle(theta)))
    return Match(pose, score, _covariance(information, field.resolution))


def _score(field: Field, thinned: Points, pose: Pose) -> float:
    return kernels.correlate(field.likelihood, thinned, *pose, 1, 0, 0, 0.0, 0.0, 0.0)[3]


def _search(field: Field, thinned: Points, centres: list[Pose], window: Window) -> tuple[Pose, Pose]:
    """The best pose of the lattices around the centres, and its centre."""
    stride = max(1, round(STRIDE / field.resolution))
    steps, turns = round(window.reach / (stride * field.resolution)), round(window.turn / TURN)
    move_cost = window.move_cost * field.resolution**2
    found = [
        kernels.correlate(field.likelihood, thinned, *centre, stride, steps, turns, TURN, move_cost, window.turn_cost)
        for centre in centres
    ]
    best = max(range(len(found)), key=lambda i: found[i][3] - DISTRUST * i)
    x, y, theta, _ = found[best]
    return Pose(x, y, theta), centres[best]


def _covariance(information: list[float], resolution: float) -> NDArray[np.float64]:
    """Inverse of the information matrix (upper triangle, cells), in metres and radians."""
    xx, xy, xt, yy, yt, tt = information
    matrix = np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])
    scale = np.array([resolution, resolution, 1.0])
    covariance: NDArray[np.float64] = np.linalg.inv(matrix) * np.outer(scale, scale)
    return covariance
