"""Scan matching where next to nothing is known about the motion since the last scan."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Points, Pose
from rce.mapping.grid import OccupancyGrid
from rce.mapping.matching import scan_matching
from rce.mapping.matching.fields import Field, every_nth
from rce.mapping.matching.kernels import compiled, correlate
from rce.mapping.matching.scan_matching import Match, fit


@dataclass(frozen=True, slots=True)
class WideSearchSettings:
    """Settings of the wide search. Costs and likelihoods are means over the points of a scan, 0..1.

    Attributes:
        reach: Metres on each side that are searched.
        turn: Radians on each side. A laser that sees half a circle sees little twice beyond.
        coarse: Cells of the field along a step of the coarse search.
        coarse_turn: Radians of a step of the coarse search.
        coarse_points: Points that the coarse search scores.
        modes: Best places of the coarse search that are refined.
        fits: Best refined places that are fitted.
        mode_steps: Coarse steps around a mode that belong to it.
        mode_turns: Coarse turns around a mode that belong to it.
        fine_stride: Cells of a step of the fine search around a mode.
        fine_steps: Steps on each side of the fine search.
        fine_turns: Turns on each side of the fine search.
        fine_turn: Radians of a turn of the fine search.
        wall: Likelihood (0..255) from which on a point is on a wall: that at 0.2 m from one.
        free: Percent below which a cell is free.
        occupied: Percent from which on a beam cannot pass a cell.
        margin: Metres at both ends of a beam that may lie in a wall.
        move_cost: Penalty for leaving the predictions, per square metre. Small: the predictions only help to choose.
        turn_cost: Penalty for leaving the predictions, per square radian.
        same: Metres; fits that are closer to each other count as one place.
        same_turn: Radians; the same for the heading.
        rival: Likelihood by which a place has to be behind the best one to be ruled out.
        least: Value of a place below which the scan contradicts the map there: the laser was tilted, or is blocked.
    """

    reach: float = 3.5
    turn: float = math.radians(80)
    coarse: int = 4
    coarse_turn: float = math.radians(2)
    coarse_points: int = 75
    modes: int = 40
    fits: int = 12
    mode_steps: int = 2
    mode_turns: int = 4
    fine_stride: int = 2
    fine_steps: int = 2
    fine_turns: int = 2
    fine_turn: float = math.radians(0.75)
    wall: int = 32
    free: int = 45
    occupied: int = 70
    margin: float = 0.4
    move_cost: float = 0.03
    turn_cost: float = 0.02
    same: float = 0.4
    same_turn: float = math.radians(8)
    rival: float = 0.15
    least: float = -0.3


SETTINGS = WideSearchSettings()


@dataclass(frozen=True, slots=True)
class Candidate:
    """Place where the robot may be.

    Attributes:
        match: The match there.
        value: Mean likelihood of the scan's points, 0..1, less penalties: the higher, the likelier is the place.
    """

    match: Match
    value: float


def search_wide(
    field: Field, free: OccupancyGrid, points: Points, predictions: list[Pose], step_cost: Callable[[Pose], float]
) -> list[Candidate]:
    """Return the poses where points fit best, anywhere around the last prediction; the best first, none if none fits.

    Multi-resolution correlative matching (Olson, Real-Time Correlative Scan Matching, 2009), except that not one but
    the best places of the coarse level are refined, rated, fitted and compared: in a building many places look alike on
    a coarse grid. Beams that end in free space or pass a wall count against a place. The covariance of each place
    covers those that are nearly as likely: in a corridor it reaches along it.

    Args:
        field: Walls around the robot.
        free: Occupancy grid of the same walls, which knows free space.
        points: (n, 2), metres, frame of the robot.
        predictions: Poses in the map frame, the most trusted first.
        step_cost: Returns the penalty of a pose for the step to it, in mean likelihood.
    """
    cells = points / field.resolution
    thinned = every_nth(cells, scan_matching.SETTINGS.search_points)

    def value(pose: Pose, score: float) -> float:
        """Return the likelihood, less the share of contradictions, less the cost of the motion."""
        leaving = min(
            scan_matching.SETTINGS.later_penalty * i + _cost(prediction, pose)
            for i, prediction in enumerate(predictions)
        )
        return score - _contradiction(field, free, pose, thinned * field.resolution) - leaving - step_cost(pose)

    centres = [field.pose_to_cells(prediction) for prediction in predictions]
    refined = [_refine(field, thinned, mode) for mode in _modes(field, thinned, centres[-1])]
    refined.sort(key=lambda place: value(*place), reverse=True)
    starts = [*centres, *(field.pose_to_cells(pose) for pose, _ in refined[: SETTINGS.fits])]
    found = [fit(field, cells, thinned, start, start) for start in starts]
    return _distinct(found, np.array([value(match.pose, match.score) for match in found]))


def _distinct(found: list[Match], values: NDArray[np.float64]) -> list[Candidate]:
    """Return the places that are not much less likely than the best one, each once; the best first."""
    distinct: list[Candidate] = []
    least = max(SETTINGS.least, values.max() - SETTINGS.rival)
    for number in np.argsort(-values):
        match, value = found[number], float(values[number])
        if value <= least:
            break
        if all(other.match.pose.to(match.pose).exceeds(SETTINGS.same, SETTINGS.same_turn) for other in distinct):
            spread = _rival_covariance(match, found, np.abs(value - values))
            covered = Match(match.pose, match.score, match.covariance + spread, unambiguous=not spread.any())
            distinct.append(Candidate(covered, value))
    return distinct


def _modes(field: Field, thinned: Points, centre: Pose) -> list[Pose]:
    """Return the best places of a coarse search around a centre that lie apart from each other; in cells."""
    settings = SETTINGS
    coarse = _max_pool(field.likelihood)
    points = every_nth(thinned, settings.coarse_points) / settings.coarse
    steps = round(settings.reach / field.resolution / settings.coarse)
    turns = round(settings.turn / settings.coarse_turn)
    x, y = ((value + 0.5) / settings.coarse - 0.5 for value in centre[:2])
    scores = correlations(coarse, points, x, y, centre.theta, steps, turns, settings.coarse_turn)
    # Non-maximum suppression: take the best place, clear its surroundings, and repeat.
    widths = settings.mode_turns, settings.mode_steps, settings.mode_steps
    modes = []
    for _ in range(settings.modes):
        peak = [int(i) for i in np.unravel_index(int(scores.argmax()), scores.shape)]
        a, v, u = peak
        shift = settings.coarse * (np.array([u, v]) - steps)
        theta = centre.theta + (a - turns) * settings.coarse_turn
        modes.append(Pose(centre.x + shift[0], centre.y + shift[1], theta))
        around = tuple(slice(max(i - width, 0), i + width + 1) for i, width in zip(peak, widths, strict=True))
        scores[around] = 0.0
    return modes


def _max_pool(likelihood: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the maximum of each coarse cell, an upper bound of the likelihood in it."""
    size = SETTINGS.coarse
    height, width = (length // size * size for length in likelihood.shape)
    blocks = likelihood[:height, :width].reshape(height // size, size, width // size, size)
    return np.ascontiguousarray(blocks.max(axis=1).max(axis=2))


def _refine(field: Field, thinned: Points, mode: Pose) -> tuple[Pose, float]:
    """Return the best pose of a fine lattice around a mode (cells), map frame, and its score."""
    stride, steps, turns = SETTINGS.fine_stride, SETTINGS.fine_steps, SETTINGS.fine_turns
    x, y, theta, score = correlate(field.likelihood, thinned, *mode, stride, steps, turns, SETTINGS.fine_turn, 0.0, 0.0)
    return field.pose_from_cells(Pose(x, y, theta)), score


def _contradiction(field: Field, free: OccupancyGrid, pose: Pose, points: Points) -> float:
    """Return the share of beams that end in free space or pass a wall.

    Args:
        field: Walls.
        free: Occupancy grid of the same walls.
        pose: Pose of the robot, map frame.
        points: (n, 2) ends of the beams, metres, frame of the robot.
    """
    ends = pose.transform(points)
    seen = free.at(ends)
    in_free = (seen >= 0) & (seen < SETTINGS.free) & (field.at(ends) <= SETTINGS.wall)
    cells = (np.concatenate([ends, [pose[:2]]]) - (free.x, free.y)) / free.resolution
    passing = passes_wall(free.cells, cells[-1], cells[:-1], SETTINGS.margin / free.resolution, SETTINGS.occupied)
    return float((in_free | passing).mean())


def _cost(prediction: Pose, pose: Pose) -> float:
    """Return the penalty, in mean likelihood, for a pose that leaves a prediction."""
    motion = prediction.to(pose)
    return SETTINGS.move_cost * (motion.x**2 + motion.y**2) + SETTINGS.turn_cost * motion.theta**2


def _rival_covariance(best: Match, found: list[Match], behind: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the covariance (3, 3) of the other places that the robot may be at.

    Args:
        best: The match that is taken.
        found: All matches.
        behind: (n,) by how much the value of each match differs from that of the match that is taken.
    """
    spread, seen = np.zeros((3, 3)), [best.pose]
    for number in np.argsort(behind):
        pose = found[number].pose
        if behind[number] >= SETTINGS.rival:
            continue
        if not all(other.to(pose).exceeds(SETTINGS.same, SETTINGS.same_turn) for other in seen):
            continue
        seen.append(pose)
        # A rival that is as likely as the best adds half the outer product of its offset, a less likely one less.
        off = np.array([pose.x - best.pose.x, pose.y - best.pose.y, best.pose.to(pose).theta])
        spread += (1.0 - behind[number] / SETTINGS.rival) * 0.5 * np.outer(off, off)
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
    """Return the mean of a field (0..1) at points for each pose of a lattice around (x, y, theta).

    Args:
        field: (height, width).
        points: (n, 2), cells, frame of the robot. Points whose whole window is not inside the field count as 0.
        x: Centre, cells.
        y: Centre, cells.
        theta: Centre, radians.
        steps: Cells on each side along x and y.
        turns: Angles on each side.
        turn: Radians between angles.

    Returns:
        (2 turns + 1, 2 steps + 1, 2 steps + 1): angles, rows, columns.
    """
    height, width = field.shape
    side, count = 2 * steps + 1, points.shape[0]
    scores = np.zeros((2 * turns + 1, side, side), np.float32)
    for a in range(2 * turns + 1):
        angle = theta + (a - turns) * turn
        c, s = math.cos(angle), math.sin(angle)
        # For each point, add the window of the field that it visits under all translations at this angle.
        for i in range(count):
            column = math.floor(x + c * points[i, 0] - s * points[i, 1] + 0.5) - steps
            row = math.floor(y + s * points[i, 0] + c * points[i, 1] + 0.5) - steps
            if min(column, row) >= 0 and column + side <= width and row + side <= height:
                scores[a] += field[row : row + side, column : column + side]
    scores /= 255.0 * count
    return scores


@compiled("boolean[::1](int8[:,::1], float64[::1], float64[:,::1], float64, int64)")
def passes_wall(
    cells: NDArray[np.int8], sensor: NDArray[np.float64], ends: NDArray[np.float64], margin: float, occupied: int
) -> NDArray[np.bool_]:
    """Return for each beam (n,) whether it passes a wall on the way to its end.

    Args:
        cells: (height, width) occupancy in percent, -1 unknown. Row and column are the whole parts of y and x.
        sensor: x, y, cells.
        ends: (n, 2) x, y of the ends of the beams, cells.
        margin: Cells at both ends of a beam that may lie in a wall.
        occupied: Percent from which on a cell is a wall.
    """
    height, width = cells.shape
    found = np.zeros(ends.shape[0], np.bool_)
    for i in range(ends.shape[0]):
        x, y = sensor[0], sensor[1]
        dx, dy = ends[i, 0] - x, ends[i, 1] - y
        length = math.hypot(dx, dy)
        way = margin
        while way < length - margin:
            column, row = math.floor(x + dx * way / length), math.floor(y + dy * way / length)
            if 0 <= column < width and 0 <= row < height and cells[row, column] >= occupied:
                found[i] = True
                break
            way += 0.5
    return found
