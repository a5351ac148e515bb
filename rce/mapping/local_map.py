"""The part of the map around the robot, with which scans are matched."""

from __future__ import annotations

import math

import numpy as np

from rce.mapping.fields import Field, square_around
from rce.mapping.geometry import Points, Pose
from rce.mapping.graph import PoseGraph
from rce.mapping.matching import Match, Window, match

RESOLUTION = 0.05
WAY = 20.0  # metres along edges; nodes nearer than this agree with each other
AROUND = 15.0  # metres from the robot to the nodes whose points are in it
FARTHEST = 40.0  # metres from the robot; beyond, the points of a laser are too sparse to match
MARGIN = 4.0  # metres that the robot may go before it is made anew
NEAR, FAR = Window(0.5, math.radians(30)), Window(1.5, math.radians(60))
DOUBT = 0.65  # a score under this makes the search go far


class LocalMap:
    """Walls seen from the nodes that are near the robot along the edges of the graph: what was passed lately, and
    what was passed long ago where a loop is closed. Its size is bounded, and so is the cost of a scan."""

    def __init__(self, graph: PoseGraph, max_range: float) -> None:
        self._graph = graph
        self._half = min(max_range, FARTHEST) + MARGIN
        self._centre = Pose(math.inf, 0.0, 0.0)
        self._field: Field | None = None
        self.nodes: set[int] = set()  # those whose points are in it

    def follow(self, reference: int, pose: Pose) -> None:
        """Make it anew around a robot that went too far from where it was made, starting at node `reference`."""
        if self._field is None or math.dist(pose[:2], self._centre[:2]) > MARGIN:
            self.renew(reference, pose)

    def renew(self, reference: int, pose: Pose) -> None:
        """Make it anew, since the graph has changed."""
        self._centre = pose
        self._field = square_around(pose, self._half, RESOLUTION)
        nodes = self._graph.nodes
        self.nodes = {
            n for n in self._graph.distances(reference, WAY) if math.dist(nodes[n].pose[:2], pose[:2]) < AROUND
        }
        for number in sorted(self.nodes):
            if nodes[number].sweeps:
                self._field.add(nodes[number].points())

    def add(self, node: int, points: Points) -> None:
        """Enter the points (n, 2), metres, map frame, of a scan that belongs to a new node."""
        self.nodes.add(node)
        if self._field is not None:
            self._field.add(points)

    def match(self, points: Points, predictions: list[Pose]) -> Match | None:
        """Where the robot is that sees the points (n, 2), metres, its frame.

        None while the map is empty, or has no prediction in it.
        """
        if self._field is None:
            return None
        low, high = self._field.bounds
        inside = [p for p in predictions if (np.array(p[:2]) > low).all() and (np.array(p[:2]) < high).all()]
        if not inside:
            return None
        found = match(self._field, points, inside, NEAR)
        if found.score >= DOUBT:
            return found
        far = match(self._field, points, inside, FAR)
        return max(found, far, key=lambda candidate: candidate.score)
