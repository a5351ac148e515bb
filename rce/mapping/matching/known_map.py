"""Known occupancy grid, prepared for matching scans with it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from rce.mapping.files.outputs import OCCUPIED
from rce.mapping.geometry import Points, Pose, wrap_angle
from rce.mapping.grid import OccupancyGrid
from rce.mapping.matching import local_map
from rce.mapping.matching.branch_and_bound import PlaceSearch, find_place
from rce.mapping.matching.fields import Field
from rce.mapping.matching.scan_matching import Match, Window, match

SEARCH = PlaceSearch(spacing=0.2, max_points=200, min_points=60, budget=2_000_000)


@dataclass(frozen=True, slots=True)
class KnownMapSettings:
    """Settings of the search of a whole known map.

    Attributes:
        search: Resolution, points and thresholds. The budget is large because there is no prediction at all.
        turns: Angles on each side; with 1 degree each, all of them.
        top_squares: Number of squares along the map on the top level of the search.
        margin: Metres around the map that belong to the fields.
        refine: Window of the match around the pose that the search has found.
    """

    search: PlaceSearch = SEARCH
    turns: int = 179
    top_squares: int = 32
    margin: float = 1.0
    refine: Window = field(default_factory=lambda: Window(0.2, math.radians(3)))


SETTINGS = KnownMapSettings()


class KnownMap:
    """Known map whose occupied cells are matched with scans.

    Attributes:
        grid: The map.
    """

    def __init__(self, grid: OccupancyGrid) -> None:
        """Prepare a map: a fine field for matching, and a pyramid for the search of the whole map."""
        self.grid = grid
        walls = grid.centres(grid.cells >= 100 * OCCUPIED)
        height, width = grid.cells.shape
        margin = SETTINGS.margin
        low = (grid.x - margin, grid.y - margin)
        high = (grid.x + width * grid.resolution + margin, grid.y + height * grid.resolution + margin)
        self._fine = Field(low, high, local_map.SETTINGS.resolution)
        self._coarse = Field(low, high, SETTINGS.search.resolution)
        for walls_field in (self._fine, self._coarse):
            walls_field.add(_fill_cells(walls, grid.resolution, local_map.SETTINGS.resolution))
        self._steps = max(self._coarse.likelihood.shape) // 2
        levels = 1 + max(1, math.ceil(math.log2(max(2 * self._steps / SETTINGS.top_squares, 1.0))))
        self._pyramid = self._coarse.pyramid(levels)

    def match(self, points: Points, predictions: list[Pose], window: Window) -> Match | None:
        """Match points (n, 2), metres, frame of the robot, near predictions; None if no prediction is in the map."""
        inside = [prediction for prediction in predictions if self._fine.contains(prediction)]
        return match(self._fine, points, inside, window) if inside else None

    def find(self, points: Points) -> Match | None:
        """Find the robot that sees points (n, 2), metres, frame of the robot, anywhere in the map.

        Returns:
            The match, or None if the points fit nowhere, fit at several places, or are too few.
        """
        search = SETTINGS.search
        query = search.points_in_view(points)
        if len(query) < search.min_points:
            return None
        cells, (height, width) = query / search.resolution, self._coarse.likelihood.shape
        centre = Pose(width / 2, height / 2, 0.0)
        found = find_place(self._pyramid, cells, centre, self._steps, SETTINGS.turns, search, turn_to_best=True)
        if found is None:
            return None
        pose = self._coarse.pose_from_cells(found._replace(theta=wrap_angle(found.theta)))
        return match(self._fine, query, [pose], SETTINGS.refine)


def _fill_cells(walls: Points, resolution: float, spacing: float) -> Points:
    """Return points at most `spacing` apart that cover the cells with centres `walls` (n, 2), all in metres.

    Cells wider than those of a field would otherwise leave gaps in its walls.
    """
    count = max(1, math.ceil(resolution / spacing - 1e-6))
    offsets = (np.arange(count) + 0.5) / count * resolution - resolution / 2
    square = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
    return np.ascontiguousarray((walls[:, None] + square[None]).reshape(-1, 2))
