"""Coverage: a path that passes a tool over all of the space that the robot can reach.

The free space is split into cells in which every sweep line is in one piece (boustrophedon decomposition: Choset,
Coverage of Known Spaces: The Boustrophedon Cellular Decomposition, 2000). Each is swept lane by lane, back and forth.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from rce.errors import InvalidRequest
from rce.mapping.geometry import Points, Pose
from rce.planning.astar import astar
from rce.planning.costmap import Costmap
from rce.planning.search.deadline import Deadline
from rce.planning.smoothing import with_headings

ENOUGH = 0.998  # share of the reachable cells after which no single ones are visited
CLOSE = 0.8  # of a tool width from lane to lane, so that lanes overlap where walls are oblique


class Coverage(NamedTuple):
    """Path that covers a space.

    Attributes:
        poses: (n, 4) x, y, theta in the map frame, and 1 (forward).
        share: Share of the reachable cells that the tool passes over.
    """

    poses: NDArray[np.float64]
    share: float


class Lane(NamedTuple):
    """Part of a sweep line: rows `low` to `high`, both included, of one column."""

    column: int
    low: int
    high: int


def cover(costmap: Costmap, start: Pose, tool_width: float, deadline: Deadline) -> Coverage:
    """Plan a path over all cells that the robot's centre can reach.

    Args:
        costmap: Costs of the cells.
        start: Start, map frame.
        tool_width: Width of the strip that the tool covers around the path, metres.
        deadline: Time limit.

    Raises:
        NoPath: The start is outside of the map or blocked, or the time is over.
        InvalidRequest: The tool is narrower than two cells.
    """
    if not tool_width >= 2 * costmap.resolution:
        least = 2 * costmap.resolution
        raise InvalidRequest(f"the tool is {tool_width:g} m wide; on this map it must be {least:g} m or more")
    row, column = costmap.start(start.x, start.y, costmap.costs)
    reachable = costmap.regions == costmap.regions[row, column]
    walk = _Walk(costmap, start, tool_width, deadline)
    spacing = max(1, math.floor(CLOSE * tool_width / costmap.resolution))
    pending = [lanes_of(cell, spacing) for cell in decompose(reachable)]
    while pending:
        index, backwards, upwards = min(
            ((index, end, turned) for index in range(len(pending)) for end in (0, 1) for turned in (0, 1)),
            key=lambda choice: walk.distance(_begin(pending[choice[0]], choice[1], choice[2])),
        )
        lanes = pending.pop(index)
        for number, lane in enumerate(reversed(lanes) if backwards else lanes):
            along = (lane.low, lane.high) if (number + upwards) % 2 else (lane.high, lane.low)
            walk.go(along[0], lane.column)
            walk.straight(along[1], lane.column)
    walk.finish(reachable)
    return Coverage(with_headings(np.concatenate(walk.points), start.theta), walk.share(reachable))


def _begin(lanes: list[Lane], backwards: int, upwards: int) -> tuple[int, int]:
    """Return row and column at which the sweep of a cell begins."""
    lane = lanes[-1 if backwards else 0]
    return (lane.low if upwards else lane.high), lane.column


def decompose(free: NDArray[np.bool_]) -> list[list[Lane]]:
    """Return the cells of the boustrophedon decomposition of a space (height, width): a lane for each of their columns.

    From one column to the next a cell goes on if its piece of the sweep line neither splits nor joins another.
    """
    finished: list[list[Lane]] = []
    active: list[list[Lane]] = []
    for column in range(free.shape[1]):
        pieces = _pieces(free[:, column], column)
        touching = [[cell for cell in active if _overlap(cell[-1], piece)] for piece in pieces]
        following = []
        for piece, before in zip(pieces, touching, strict=True):
            single = len(before) == 1 and sum(before[0] is cell for cells in touching for cell in cells) == 1
            cell = before[0] if single else []
            cell.append(piece)
            following.append(cell)
        finished += [cell for cell in active if not any(cell is each for each in following)]
        active = following
    return finished + active


def _pieces(line: NDArray[np.bool_], column: int) -> list[Lane]:
    changes = np.flatnonzero(np.diff(np.concatenate([[0], line.astype(np.int8), [0]])))
    return [Lane(column, int(low), int(high) - 1) for low, high in changes.reshape(-1, 2)]


def _overlap(one: Lane, other: Lane) -> bool:
    return one.low <= other.high and other.low <= one.high


def lanes_of(cell: list[Lane], spacing: int) -> list[Lane]:
    """Return the lanes to sweep, evenly distributed: at most `spacing` columns apart, half of it from the ends."""
    count = max(1, math.ceil(len(cell) / spacing))
    return [cell[min(len(cell) - 1, int((number + 0.5) * len(cell) / count))] for number in range(count)]


class _Walk:
    """Path that grows, and the cells that its tool has covered."""

    def __init__(self, costmap: Costmap, start: Pose, tool_width: float, deadline: Deadline) -> None:
        self._costmap, self._deadline = costmap, deadline
        self._at = costmap.cell(start.x, start.y)
        self._visited = np.full(costmap.costs.shape, 255, np.uint8)
        self._radius = tool_width / 2 / costmap.resolution
        self.points: list[Points] = [np.array([start[:2]])]

    def distance(self, cell: tuple[int, int]) -> float:
        """Return the cells to a cell as the crow flies."""
        return math.dist(self._at, cell)

    def go(self, row: int, column: int) -> None:
        """Take the shortest way to a cell."""
        self._deadline.check()
        ends = self._costmap.points(*np.array([self._at, (row, column)]).T)
        here, there = (Pose(x, y, 0.0) for x, y in ends.tolist())
        points, _ = astar(self._costmap, here, there, 0.0, 0.0, self._deadline)
        self._add(points[1:])
        self._at = row, column

    def straight(self, row: int, column: int) -> None:
        """Follow a column to a cell."""
        step = 1 if row >= self._at[0] else -1
        rows = np.arange(self._at[0] + step, row + step, step)
        self._add(self._costmap.points(rows, np.full(len(rows), column)))
        self._at = row, column

    def _add(self, points: Points) -> None:
        columns, rows = np.floor((points - self._costmap.corner) / self._costmap.resolution).astype(np.int64).T
        self._visited[rows, columns] = 0
        self.points.append(points)

    def _uncovered(self, reachable: NDArray[np.bool_]) -> NDArray[np.bool_]:
        distance = cv2.distanceTransform(self._visited, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        left: NDArray[np.bool_] = reachable & (distance > self._radius)
        return left

    def share(self, reachable: NDArray[np.bool_]) -> float:
        """Return the share of the reachable cells that are covered."""
        return 1.0 - float(self._uncovered(reachable).sum()) / float(reachable.sum())

    def finish(self, reachable: NDArray[np.bool_]) -> None:
        """Visit what the lanes have left: niches, and the space between the ends of lanes."""
        allowed = (1 - ENOUGH) * float(reachable.sum())
        while (left := np.argwhere(self._uncovered(reachable))).shape[0] > allowed:
            row, column = left[np.hypot(*(left - self._at).T).argmin()].tolist()
            self.go(row, column)
