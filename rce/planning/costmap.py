"""Costmap: what each cell of an occupancy grid costs a robot, as Nav2's inflation layer counts it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Points
from rce.mapping.grid import OccupancyGrid
from rce.planning.failures import NoPath, Reason
from rce.planning.footprint import Footprint

LETHAL, BLOCKED, HIGHEST = 254, 253, 252
"""Costs of a cell that is occupied, that the robot's centre must not enter, and of the worst that it may enter."""
OCCUPIED = 65  # percent from which on a cell is an obstacle
BORDER = 1  # cells around the grid: its edge is a wall, and searches need no test for it


@dataclass(frozen=True, slots=True)
class Inflation:
    """Costs around obstacles. The fields are the parameters of Nav2's inflation layer.

    Attributes:
        inflation_radius: Distance from an obstacle from which on cells cost nothing, metres.
        cost_scaling_factor: Decay of the costs, 1/metres.
    """

    inflation_radius: float = 0.55
    cost_scaling_factor: float = 3.0


INFLATION = Inflation()


class Costmap:
    """Costs of the cells of one map for one robot. Cells are those of the grid with a border of one cell around it.

    The border is part of all arrays here: cell [0, 0] of the grid is cell [1, 1].
    """

    def __init__(
        self, grid: OccupancyGrid, footprint: Footprint, inflation: Inflation = INFLATION, allow_unknown: bool = False
    ) -> None:
        """Compute the distance of each cell from the nearest obstacle.

        Args:
            grid: The map.
            footprint: Outline of the robot.
            inflation: Costs around obstacles.
            allow_unknown: Whether unknown cells are free; otherwise they are obstacles.
        """
        self.footprint, self.inflation, self.resolution = footprint, inflation, grid.resolution
        self.corner = np.array([grid.x, grid.y]) - BORDER * grid.resolution
        occupied = grid.cells >= OCCUPIED
        blocked = occupied if allow_unknown else occupied | (grid.cells < 0)
        free = np.zeros((grid.cells.shape[0] + 2 * BORDER, grid.cells.shape[1] + 2 * BORDER), np.uint8)
        free[BORDER:-BORDER, BORDER:-BORDER] = ~blocked
        self.clearance: NDArray[np.float32] = np.asarray(
            cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE), np.float32
        )
        self.clearance *= np.float32(grid.resolution)

    @cached_property
    def costs(self) -> NDArray[np.uint8]:
        """Costs (height, width) for a robot that may turn anywhere: its circumscribed circle must keep clear."""
        return self._inflated(self.footprint.circumscribed)

    @cached_property
    def inscribed_costs(self) -> NDArray[np.uint8]:
        """Costs (height, width) as Nav2 has them: only the inscribed circle must keep clear."""
        return self.costs if not self.footprint.corners else self._inflated(self.footprint.inscribed)

    @cached_property
    def regions(self) -> NDArray[np.int32]:
        """Number (height, width) of the connected region of each cell, 8-connected; 0 if it is blocked in `costs`."""
        _, labels = cv2.connectedComponents((self.costs < BLOCKED).astype(np.uint8), connectivity=8)
        return np.asarray(labels, np.int32)

    def cell(self, x: float, y: float) -> tuple[int, int]:
        """Return row and column of a point, metres, map frame, which may be outside of the map."""
        column, row = np.floor((np.array([x, y]) - self.corner) / self.resolution).tolist()
        return int(row), int(column)

    def points(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Points:
        """Return the centres (n, 2), metres, map frame, of cells."""
        centres: Points = (np.stack([columns, rows], axis=1) + 0.5) * self.resolution + self.corner
        return centres

    def start(self, x: float, y: float, costs: NDArray[np.uint8]) -> tuple[int, int]:
        """Return the cell of a start, metres, map frame.

        Raises:
            NoPath: It is outside of the map, or blocked.
        """
        row, column = self.cell(x, y)
        if not self._has(row, column):
            raise NoPath(f"the start ({x:g}, {y:g}) is {self._outside()}", Reason.START_OUTSIDE_MAP)
        if costs[row, column] >= BLOCKED:
            raise self.occupied("start", x, y)
        return row, column

    def goal(self, x: float, y: float) -> tuple[int, int]:
        """Return the cell of a goal, metres, map frame, which may be blocked.

        Raises:
            NoPath: It is outside of the map.
        """
        row, column = self.cell(x, y)
        if not self._has(row, column):
            raise NoPath(f"the goal ({x:g}, {y:g}) is {self._outside()}", Reason.GOAL_OUTSIDE_MAP)
        return row, column

    def occupied(self, end: Literal["start", "goal"], x: float, y: float) -> NoPath:
        """Return the error of a start or goal at which the robot would touch an obstacle."""
        reason = Reason.START_OCCUPIED if end == "start" else Reason.GOAL_OCCUPIED
        return NoPath(f"the {end} ({x:g}, {y:g}) is {self._fault(*self.cell(x, y))}", reason)

    def _has(self, row: int, column: int) -> bool:
        height, width = self.clearance.shape
        return bool(BORDER <= row < height - BORDER and BORDER <= column < width - BORDER)

    def _outside(self) -> str:
        height, width = self.clearance.shape
        low = self.corner + BORDER * self.resolution
        high = self.corner + (np.array([width, height]) - BORDER) * self.resolution
        return f"outside of the map, which reaches from ({low[0]:g}, {low[1]:g}) to ({high[0]:g}, {high[1]:g})"

    def _fault(self, row: int, column: int) -> str:
        clearance = float(self.clearance[row, column])
        if clearance == 0.0:
            return "in an obstacle or in unknown space"
        return f"{clearance:.2f} m from an obstacle or unknown space, which is too near for the robot's footprint"

    def _inflated(self, radius: float) -> NDArray[np.uint8]:
        """Return the costs: BLOCKED within `radius` of an obstacle, from there on HIGHEST, falling exponentially."""
        squares = math.ceil((self.inflation.inflation_radius + radius) / self.resolution) + 1
        # One entry for each squared distance in cells, which is a whole number.
        distance = np.sqrt(np.arange(squares * squares + 1)) * self.resolution
        costs = HIGHEST * np.exp(-self.inflation.cost_scaling_factor * (distance - radius))
        costs[distance > max(self.inflation.inflation_radius, radius)] = 0
        costs[distance <= radius] = BLOCKED
        costs[0] = LETHAL
        cells = self.clearance / np.float32(self.resolution)
        index = np.minimum(np.rint(cells * cells), squares * squares).astype(np.int32)
        return np.ascontiguousarray(costs.astype(np.uint8)[index])
