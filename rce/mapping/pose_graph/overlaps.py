"""Overlaps of maps: finding a place of one robot in the whole map of another, without a common frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Points, Pose
from rce.mapping.matching.branch_and_bound import PlaceSearch, find_place
from rce.mapping.matching.fields import Field
from rce.mapping.matching.scan_matching import fit
from rce.mapping.pose_graph.graph import Matrix, PoseGraph, information_matrix, points_around

SEARCH = PlaceSearch(
    spacing=0.15, max_points=300, min_points=80, budget=150_000, min_score=0.62, rival_distance=1.0, rival_ratio=0.9
)


@dataclass(frozen=True, slots=True)
class OverlapSettings:
    """Settings of the search of a whole map of another robot.

    Attributes:
        search: Resolution, points and thresholds. They are stricter than those of loops, since nothing is known about
            where the place is.
        levels: Levels of the pyramid.
        way: Metres along edges around a place that belong to it.
        margin: Metres around the map that belong to the field.
        floor: Standard deviations, metres and radians, that are added to those of a match; see `information_matrix`.
        scale: Factor of the covariance of a match; see `information_matrix`.
        new_nodes: New nodes after which the field of a map is rebuilt.
        moved: Metres or radians of motion of a node after which it is rebuilt.
    """

    search: PlaceSearch = SEARCH
    levels: int = 7
    way: float = 10.0
    margin: float = 1.0
    floor: tuple[float, float] = (0.03, math.radians(0.5))
    scale: float = 4.0
    new_nodes: int = 8
    moved: float = 0.05


SETTINGS = OverlapSettings()


@dataclass(frozen=True, slots=True)
class PlaceMatch:
    """Pose of a place that was found in a map.

    Attributes:
        motion: Pose of the place in the frame that was searched.
        information: (3, 3) inverse covariance of the pose, in that frame.
    """

    motion: Pose
    information: Matrix


def place_points(graph: PoseGraph, number: int) -> Points | None:
    """Return the points (n, 2) around a node, in its frame, or None if they are too few to recognise the place."""
    search = SETTINGS.search
    found = search.points_in_view(np.concatenate(list(points_around(graph, number, SETTINGS.way))))
    return found if len(found) >= search.min_points else None


class WholeMap:
    """Map of one robot, prepared to be searched as a whole until it has grown or was corrected."""

    def __init__(self, graph: PoseGraph) -> None:
        """Search the map of a graph, which may grow."""
        self._graph = graph
        self._poses = np.empty((0, 3))  # of the nodes that are in the field
        self._field: Field
        self._pyramid: NDArray[np.uint8]

    def find(self, query: Points) -> PlaceMatch | None:
        """Find the place at which points (n, 2) are seen; None if it is nowhere in this map, or ambiguous.

        Correlative matching over all positions and angles by branch and bound (Hess et al., Real-Time Loop Closure in
        2D LIDAR SLAM, 2016); see `find_place`.
        """
        self._update_field()
        cells = query / SETTINGS.search.resolution
        height, width = self._field.likelihood.shape
        steps, turns = max(height, width) // 2 + 1, round(math.pi / SETTINGS.search.turn)
        found = find_place(self._pyramid, cells, Pose(width / 2, height / 2, 0.0), steps, turns, SETTINGS.search)
        return None if found is None else refine_place(self._field, cells, found)

    def _update_field(self) -> None:
        """Rebuild the field if the map has grown or a node has moved."""
        poses = self._graph.poses()
        known = len(self._poses)
        moved = np.abs(poses[:known] - self._poses).max(initial=0.0)
        if known and len(poses) < known + SETTINGS.new_nodes and moved < SETTINGS.moved:
            return
        self._poses = poses
        points = np.concatenate([node.points() for node in self._graph.nodes.values()])
        low, high = points.min(axis=0) - SETTINGS.margin, points.max(axis=0) + SETTINGS.margin
        self._field = Field((low[0], low[1]), (high[0], high[1]), SETTINGS.search.resolution)
        self._field.add(points)
        self._pyramid = self._field.pyramid(SETTINGS.levels)


def refine_place(field: Field, cells: Points, start: Pose) -> PlaceMatch:
    """Fit points (n, 2) to a field near a pose; both in cells."""
    fitted = fit(field, cells, cells, start, start)
    return PlaceMatch(fitted.pose, information_matrix(fitted.covariance, 0.0, SETTINGS.floor, SETTINGS.scale))
