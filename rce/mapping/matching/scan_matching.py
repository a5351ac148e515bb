"""Scan matching near a prediction: a fit to normal distributions, and a correlative search where that fails."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Points, Pose, wrap_angle
from rce.mapping.matching import kernels, ndt
from rce.mapping.matching.fields import Field, every_nth


@dataclass(frozen=True, slots=True)
class MatchSettings:
    """Settings of scan matching. Scores and likelihoods are means over the points of a scan, 0..1.

    Attributes:
        good_score: Score of the fitted prediction from which on nothing else is searched.
        stride: Metres between positions of the search. The likelihood field reaches from one to the next.
        turn: Radians between angles of the search.
        search_points: Points that are scored; more make the search slower and not better.
        later_penalty: Likelihood by which a place around a later prediction must exceed one around an earlier one.
        search_penalty: Likelihood by which a pose that was searched for must exceed the fitted prediction.
        fit_loss: Score that a fit may lose. A larger loss means that there was too little to fit to.
        noise: Metres; standard deviation of a measured point, with the distortion by the motion during the sweep.
        iterations: Maximum number of iterations of the fit.
        trust: Metres of spread of the prediction at which it has the weight of one point.
    """

    good_score: float = 0.9
    stride: float = 0.1
    turn: float = math.radians(1.5)
    search_points: int = 150
    later_penalty: float = 0.05
    search_penalty: float = 0.02
    fit_loss: float = 0.02
    noise: float = 0.04
    iterations: int = 20
    trust: float = 0.004


SETTINGS = MatchSettings()


@dataclass(frozen=True, slots=True)
class Window:
    """Window of a search around a predicted pose.

    Attributes:
        reach: Metres on each side along x and y.
        turn: Radians on each side.
        move_cost: Penalty for leaving the prediction, mean likelihood per square metre.
        turn_cost: Penalty for leaving the prediction, mean likelihood per square radian.
    """

    reach: float
    turn: float
    move_cost: float = 0.3
    turn_cost: float = 0.3


@dataclass(frozen=True, slots=True)
class Match:
    """Pose at which a scan was matched with a map.

    Attributes:
        pose: Pose of the robot in the map frame.
        score: Mean likelihood of the points there (0..1).
        covariance: (3, 3) of x, y, theta in square metres and radians, map frame, as if the points were independent.
        unambiguous: Whether no other place that was searched is nearly as likely. If not, the covariance covers those
            places as well.
    """

    pose: Pose
    score: float
    covariance: NDArray[np.float64]
    unambiguous: bool = True


def match(field: Field, points: Points, predictions: list[Pose], window: Window, spread: float = math.inf) -> Match:
    """Return the pose near one of the predictions at which the points fit best.

    Where many points show what is not in the field yet, a wrong pose may seem as likely as the right one. The fit next
    to the first prediction is therefore kept unless another pose is clearly better.

    Args:
        field: Walls around the robot.
        points: (n, 2), metres, frame of the robot.
        predictions: Poses in the map frame, the most trusted first.
        window: Window of the search around each prediction.
        spread: Metres by which the first prediction is usually off. In a corridor, where a few points that belong to no
            wall would pull the pose along it, this is what holds the pose.
    """
    cells = points / field.resolution
    thinned = every_nth(cells, SETTINGS.search_points)
    centres = [field.pose_to_cells(prediction) for prediction in predictions]
    pull = max(ndt.SETTINGS.pull, (SETTINGS.trust / spread) ** 2)
    expected = fit(field, cells, thinned, centres[0], centres[0], pull)
    if expected.score >= SETTINGS.good_score:
        return expected
    start, centre = _search(field, thinned, centres, window)
    found = fit(field, cells, thinned, start, centre)
    return found if found.score > expected.score + SETTINGS.search_penalty else expected


def fit(
    field: Field, cells: Points, thinned: Points, start: Pose, expected: Pose, pull: float = ndt.SETTINGS.pull
) -> Match:
    """Fit points to the normal distributions of a field, and score a part of them.

    Args:
        field: Walls around the robot.
        cells: (n, 2) points to fit, cells, frame of the robot.
        thinned: (m, 2) points to score, cells, frame of the robot.
        start: Start of the optimisation, x and y in cells.
        expected: Pose that decides in directions which the walls leave open, x and y in cells.
        pull: Weight of the expected pose, see `ndt.align`.

    Returns:
        The match in metres, map frame.
    """
    variance = (SETTINGS.noise / field.resolution) ** 2
    fitted = ndt.align(
        field.tiles, field.table, cells, *start, *expected, field.ratio, variance, SETTINGS.iterations, pull
    )
    x, y, theta, *information = fitted.tolist()
    score, before = _score(field, thinned, Pose(x, y, theta)), _score(field, thinned, start)
    if score < before - SETTINGS.fit_loss:
        (x, y, theta), score = start, before
    pose = field.pose_from_cells(Pose(x, y, wrap_angle(theta)))
    return Match(pose, score, _covariance(information, field.resolution))


def _score(field: Field, thinned: Points, pose: Pose) -> float:
    """Return the mean likelihood (0..1) of points at one pose; both in cells."""
    return kernels.correlate(field.likelihood, thinned, *pose, 1, 0, 0, 0.0, 0.0, 0.0)[3]


def _search(field: Field, thinned: Points, centres: list[Pose], window: Window) -> tuple[Pose, Pose]:
    """Return the best pose of the lattices around the centres, and its centre; all in cells."""
    stride = max(1, round(SETTINGS.stride / field.resolution))
    steps, turns = round(window.reach / (stride * field.resolution)), round(window.turn / SETTINGS.turn)
    move_cost = window.move_cost * field.resolution**2
    found = [
        kernels.correlate(
            field.likelihood, thinned, *centre, stride, steps, turns, SETTINGS.turn, move_cost, window.turn_cost
        )
        for centre in centres
    ]
    best = max(range(len(found)), key=lambda i: found[i][3] - SETTINGS.later_penalty * i)
    x, y, theta, _ = found[best]
    return Pose(x, y, theta), centres[best]


def _covariance(information: list[float], resolution: float) -> NDArray[np.float64]:
    """Invert an information matrix (upper triangle, cells); return the covariance (3, 3) in metres and radians."""
    xx, xy, xt, yy, yt, tt = information
    matrix = np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])
    scale = np.array([resolution, resolution, 1.0])
    covariance: NDArray[np.float64] = np.linalg.inv(matrix) * np.outer(scale, scale)
    return covariance
