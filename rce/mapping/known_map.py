"""A map that is there already, made ready for matching scans with it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rce.mapping import branching
from rce.mapping.fields import Field, thin
from rce.mapping.geometry import Points, Pose, wrap_angle
from rce.mapping.grid import OccupancyGrid
from rce.mapping.local_map import RESOLUTION
from rce.mapping.loops import APART, APART_TURN, NOTHING, RIVAL, VIEW
from rce.mapping.matching import Match, Window, match
from rce.mapping.outputs import OCCUPIED

COARSE, TURN, TURNS = 0.1, math.radians(1), 179  # metres, radians, and angles to each side of a search everywhere
WIDTH, MOST = 0.2, 200  # metres between the points that are searched for, and their number
FEWEST = 60  # points; with fewer, no search
LEAST = 0.6  # score of a place that is believed
SIDE = 32  # squares along the map at the top of the search
BUDGET = 2_000_000  # poses looked at in a search
MARGIN = 1.0  # metres around the map
CHECK = Window(0.2, math.radians(3))  # around what the search has found


class KnownMap:
    """`grid`: the map. Its occupied cells are what scans are matched with."""

    def __init__(self, grid: OccupancyGrid) -> None:
        self.grid = grid
        rows, columns = np.nonzero(grid.cells >= 100 * OCCUPIED)
        walls: Points = (np.stack([columns, rows], axis=1) + 0.5) * grid.resolution + np.array([grid.x, grid.y])
        height, width = grid.cells.shape
        low = (grid.x - MARGIN, grid.y - MARGIN)
        high = (grid.x + width * grid.resolution + MARGIN, grid.y + height * grid.resolution + MARGIN)
        self._fine, self._coarse = Field(low, high, RESOLUTION), Field(low, high, COARSE)
        for field in (self._fine, self._coarse):
            # Cells that are wider than those of the field are entered as the points they cover.
            field.add(_filled(walls, grid.resolution, RESOLUTION))
        self._steps = max(self._coarse.likelihood.shape) // 2
        self._pyramid = self._coarse.pyramid(1 + max(1, math.ceil(math.log2(max(2 * self._steps / SIDE, 1.0)))))

    def match(self, points: Points, predictions: list[Pose], window: Window) -> Match | None:
        """Where the robot is that sees the points (n, 2), metres, its frame; None if no prediction is in the map."""
        low, high = self._fine.bounds
        inside = [p for p in predictions if (np.array(p[:2]) > low).all() and (np.array(p[:2]) < high).all()]
        return match(self._fine, points, inside, window) if inside else None

    def find(self, points: Points) -> Match | None:
        """Where in the whole map the robot is that sees the points (n, 2), metres, its frame.

        None if they fit nowhere, or at several places, or are too few to tell (Hess et al., Real-Time Loop Closure in
        2D LIDAR SLAM, 2016, and the check for rivals as in `loops`).
        """
        query = thin(points[np.hypot(points[:, 0], points[:, 1]) < VIEW], WIDTH, MOST)
        if len(query) < FEWEST:
            return None
        cells, (height, width) = query / COARSE, self._coarse.likelihood.shape
        found = self._search(cells, Pose(width / 2, height / 2, 0.0), LEAST, NOTHING)
        if found[3] <= LEAST:
            return None
        x, y, theta, score = found
        rival = RIVAL * score
        around = np.array([x, y, theta, APART / COARSE, APART_TURN])
        if self._search(cells, Pose(width / 2, height / 2, theta), rival, around)[3] != rival:
            return None  # there is one, or it takes too long to know
        pose = self._coarse.pose_from_cells(Pose(x, y, wrap_angle(theta)))
        return match(self._fine, query, [pose], CHECK)

    def _search(
        self, cells: Points, centre: Pose, least: float, excluded: NDArray[np.float64]
    ) -> tuple[float, float, float, float]:
        x, y, theta, score = branching.branch_and_bound(
            self._pyramid, cells, *centre, self._steps, TURNS, TURN, least, excluded, BUDGET
        ).tolist()
        return x, y, theta, score


def _filled(walls: Points, resolution: float, width: float) -> Points:
    """For each cell of a grid, by its centre (n, 2), points that are at most `width` apart."""
    count = max(1, math.ceil(resolution / width - 1e-6))
    offsets = (np.arange(count) + 0.5) / count * resolution - resolution / 2
    square = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
    return np.ascontiguousarray((walls[:, None] + square[None]).reshape(-1, 2))
