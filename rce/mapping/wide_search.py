"""Finding the pose of a scan where next to nothing is known about how the robot moved since the last one."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rce.mapping.fields import Field
from rce.mapping.geometry import Points, Pose
from rce.mapping.grid import OccupancyGrid
from rce.mapping.kernels import compiled, correlate
from rce.mapping.matching import DISTRUST, SEARCH_POINTS, Match, fit

REACH, TURN = 3.5, math.radians(80)  # on each side: a laser that sees half around sees little twice beyond
COARSE, COARSE_TURN = 4, math.radians(2)  # cells a step, radians a step
COARSE_POINTS = 75
MODES = 12  # places that are looked at closely
MODE_STEPS, MODE_TURNS = 2, 4  # coarse steps around one that belong to it
FINE_STRIDE, FINE_STEPS, FINE_TURNS, FINE_TURN = 2, 1, 2, math.radians(0.75)
WALL = 32  # likelihood around a wall (0..255) at 0.2 m from it; a point further off is not on it
FREE = 45  # percent; of a cell that beams went through
MOVE_COST, TURN_COST = 0.03, 0.02  # of leaving the predictions, per square metre and square radian, in mean likelihood
SAME, SAME_TURN = 0.4, math.radians(8)  # fits that are nearer to each other are one
RIVAL = 0.15  # mean likelihood; a place that is less likely by more is out of the question


def match_wide(field: Field, free: OccupancyGrid, points: Points, predictions: list[Pose]) -> Match:
    """The pose at which points (n, 2), metres, frame of the robot, fit best, anywhere around the last prediction.
    `free`: a grid of the same walls, which knows where beams went through.

    Coarse to fine (Olson, Real-Time Correlative Scan Matching, 2009): the best places of a coarse search are refined,
    fitted and compared, since in a building many places look alike from far. The predictions only help to choose. The
    covariance covers the places that are nearly as good: in a corridor it reaches along it.
    """
    cells = points / field.resolution
    thinned = np.ascontiguousarray(cells[:: max(1, len(cells) // SEARCH_POINTS)])
    centres = [field.pose_to_cells(prediction) for prediction in predictions]
    starts = [*centres, *(_refined(field, thinned, mode) for mode in _modes(field, thinned, centres[-1]))]
    found = [fit(field, cells, thinned, start, start) for start in starts]
    values = [
        match.score
        - _contradiction(field, free, match.pose.transform(thinned * field.resolution))
        - min(DISTRUST * i + _cost(prediction, match.pose) for i, prediction in enumerate(predictions))
        for match in found
    ]
    best = found[int(np.argmax(values))]
    spread = _rivalry(best, found, max(values) - np.array(values))
    return Match(best.pose, best.score, best.covariance + spread, sure=not spread.any())


def _modes(field: Field, thinned: Points, centre: Pose) -> list[Pose]:
    """The best places of a coarse search around a centre that lie apart from each other; cells."""
    coarse = _pooled(field.likelihood)
    points = np.ascontiguousarray(thinned[:: max(1, len(thinned) // COARSE_POINTS)] / COARSE)
    steps, turns = round(REACH / field.resolution / COARSE), round(TURN / COARSE_TURN)
    x, y = ((value + 0.5) / COARSE - 0.5 for value in centre[:2])
    scores = correlations(coarse, points, x, y, centre.theta, steps, turns, COARSE_TURN)
    modes = []
    for _ in range(MODES):
        a, v, u = (int(i) for i in np.unravel_index(int(scores.argmax()), scores.shape))
        shift = COARSE * (np.array([u, v]) - steps)
        modes.append(Pose(centre.x + shift[0], centre.y + shift[1], centre.theta + (a - turns) * COARSE_TURN))
        low = (max(a - MODE_TURNS, 0), max(v - MODE_STEPS, 0), max(u - MODE_STEPS, 0))
        scores[low[0] : a + MODE_TURNS + 1, low[1] : v + MODE_STEPS + 1, low[2] : u + MODE_STEPS + 1] = 0.0
    return modes


def _pooled(likelihood: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The largest of each block of COARSE by COARSE cells."""
    height, width = (size // COARSE * COARSE for size in likelihood.shape)
    blocks = likelihood[:height, :width].reshape(height // COARSE, COARSE, width // COARSE, COARSE)
    return np.ascontiguousarray(blocks.max(axis=1).max(axis=2))


def _refined(field: Field, thinned: Points, mode: Pose) -> Pose:
    x, y, theta, _ = correlate(
        field.likelihood, thinned, *mode, FINE_STRIDE, FINE_STEPS, FINE_TURNS, FINE_TURN, 0.0, 0.0
    )
    return Pose(x, y, theta)


def _contradiction(field: Field, free: OccupancyGrid, points: Points) -> float:
    """The share of points (n, 2), metres, map frame, that were measured where there is nothing."""
    seen = free.at(points)
    return float(((seen >= 0) & (seen < FREE) & (field.at(points) <= WALL)).mean())


def _cost(prediction: Pose, pose: Pose) -> float:
    motion = prediction.to(pose)
    return MOVE_COST * (motion.x**2 + motion.y**2) + TURN_COST * motion.theta**2


def _rivalry(best: Match, found: list[Match], behind: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariance (3, 3) of other places that the robot may be at; `behind`: by how much they are less likely (n,)."""
    spread, seen = np.zeros((3, 3)), [best.pose]
    for number in np.argsort(behind):
        pose = found[number].pose
        if behind[number] >= RIVAL or not all(other.to(pose).moved(SAME, SAME_TURN) for other in seen):
            continue
        seen.append(pose)
        off = np.array([pose.x - best.pose.x, pose.y - best.pose.y, best.pose.to(pose).theta])
        spread += (1.0 - behind[number] / RIVAL) * 0.5 * np.outer(off, off)
    return spread


@compiled("float32[:,:,::1](uint8[:,::1], float64[:,::1], float64, float64, float64, int64, int64, float64)")
def correlations(
    field: NDArray[np.uint8],
    points: NDArray[np.float64],
    x: float,
    y: float,
    theta: float,
    steps: int,
    turns: int,
    turn: float,
) -> NDArray[np.float32]:
    """Mean of the field (0..1) at points (n, 2), cells, frame of the robot, for each pose around (x, y, theta): angles,
    rows, columns (2 turns + 1, 2 steps + 1, 2 steps + 1), a cell and `turn` radians apart."""
    height, width = field.shape
    side, count = 2 * steps + 1, points.shape[0]
    scores = np.zeros((2 * turns + 1, side, side), np.float32)
    for a in range(2 * turns + 1):
        angle = theta + (a - turns) * turn
        c, s = math.cos(angle), math.sin(angle)
        for i in range(count):
            column = math.floor(x + c * points[i, 0] - s * points[i, 1] + 0.5) - steps
            row = math.floor(y + s * points[i, 0] + c * points[i, 1] + 0.5) - steps
            if min(column, row) >= 0 and column + side <= width and row + side <= height:
                scores[a] += field[row : row + side, column : column + side]
    scores /= 255.0 * count
    return scores
