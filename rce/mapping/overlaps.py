"""Noticing that two robots have been at the same place, though nobody knows how their maps lie to each other."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping import branching
from rce.mapping.fields import Field, thin
from rce.mapping.geometry import Points, Pose
from rce.mapping.graph import Matrix, PoseGraph, around, information_of
from rce.mapping.matching import fit

RESOLUTION, LEVELS, TURN = 0.1, 7, math.radians(1)
RECENT, VIEW = 10.0, 15.0  # metres along edges around a place, and metres from it, that are compared
WIDTH, MOST, FEWEST = 0.15, 300, 80  # of the points of a place: metres between them, most and fewest
LEAST = 0.62  # score
BUDGET = 150_000  # poses looked at in a search of a whole map
APART, APART_TURN, RIVAL = 1.0, math.radians(10), 0.9  # another pose as good as this makes a place ambiguous
NOTHING = np.zeros(5)  # is excluded
FLOOR, SCALE = (0.03, math.radians(0.5)), 4.0
GROWN, MOVED = 8, 0.05  # nodes, and metres or radians by which one has moved, after which a map is looked at anew


@dataclass(frozen=True, slots=True)
class Match:
    """The place is at `motion` in the frame it was searched in; `information` (3, 3) about it in that frame."""

    motion: Pose
    information: Matrix


def place(graph: PoseGraph, number: int) -> Points | None:
    """What is to be seen around a node (n, 2), its frame; None if that is too little to know it again by."""
    points = np.concatenate(list(around(graph, number, RECENT)))
    thinned = thin(points[np.hypot(points[:, 0], points[:, 1]) < VIEW], WIDTH, MOST)
    return thinned if len(thinned) >= FEWEST else None


class WholeMap:
    """One robot's map, to be searched as a whole; kept until the map has grown or was corrected."""

    def __init__(self, graph: PoseGraph) -> None:
        self._graph = graph
        self._poses = np.empty((0, 3))  # of the nodes that are in the field
        self._field: Field
        self._pyramid: NDArray[np.uint8]

    def find(self, query: Points) -> Match | None:
        """Where a place (n, 2) is in this map (its frame); None if nowhere, or in doubt.

        Correlative matching over all positions and angles by branch and bound (Hess et al., 2016); a place that fits
        nearly as well elsewhere is in doubt.
        """
        self._renew()
        cells = query / RESOLUTION
        x, y, theta, score = self._search(cells, LEAST, NOTHING)
        if score <= LEAST:
            return None
        excluded, rival = np.array([x, y, theta, APART / RESOLUTION, APART_TURN]), RIVAL * score
        if self._search(cells, rival, excluded)[3] != rival:
            return None
        return refined(self._field, cells, Pose(x, y, theta))

    def _renew(self) -> None:
        poses = self._graph.poses()
        known = len(self._poses)
        moved = np.abs(poses[:known] - self._poses).max(initial=0.0)
        if known and len(poses) < known + GROWN and moved < MOVED:
            return
        self._poses = poses
        points = np.concatenate([node.points() for node in self._graph.nodes.values()])
        low, high = points.min(axis=0) - 1.0, points.max(axis=0) + 1.0
        self._field = Field((low[0], low[1]), (high[0], high[1]), RESOLUTION)
        self._field.add(points)
        self._pyramid = self._field.pyramid(LEVELS)

    def _search(self, cells: Points, least: float, excluded: NDArray[np.float64]) -> tuple[float, float, float, float]:
        height, width = self._field.likelihood.shape
        steps, turns = max(height, width) // 2 + 1, round(math.pi / TURN)
        found = branching.branch_and_bound(
            self._pyramid, cells, width / 2, height / 2, 0.0, steps, turns, TURN, least, excluded, BUDGET
        )
        x, y, theta, score = found.tolist()
        return x, y, theta, score


def refined(field: Field, cells: Points, start: Pose) -> Match:
    """Where points (n, 2) fit best near a pose; both in cells."""
    fitted = fit(field, cells, cells, start, start)
    return Match(fitted.pose, information_of(fitted.covariance, 0.0, FLOOR, SCALE))
