"""Loop closing: recognising that the robot is at a place that it has visited before."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.matching.agreement import Surroundings, agreement
from rce.mapping.matching.branch_and_bound import PlaceSearch, find_place
from rce.mapping.matching.fields import square_around
from rce.mapping.pose_graph.graph import (
    DRIFT,
    Edge,
    Matrix,
    PoseGraph,
    edges_state,
    points_around,
    restore_edges,
)
from rce.mapping.pose_graph.overlaps import PlaceMatch, refine_place
from rce.mapping.state import Reader, State

SEARCH = PlaceSearch(spacing=0.15, max_points=300, min_points=30, budget=40_000)


@dataclass(frozen=True, slots=True)
class LoopSettings:
    """Settings of loop closing.

    Attributes:
        search: Resolution, points and thresholds of the search for a place.
        levels: Levels of the pyramid.
        min_way: Metres along edges; closer nodes cannot have drifted enough to matter.
        recent: Metres along edges around the new node that are compared.
        place: Metres along edges around the old node that are compared; also metres between the two old nodes that are
            tried.
        min_reach: Metres that are searched around the estimate at least.
        max_reach: Metres that are searched at most.
        min_turn: Radians that are searched around the estimate at least.
        max_turn: Radians that are searched at most.
        reach_margin: Metres; an old node may be this much beyond the reach, since places are not points.
        min_agreement: Share of walls and free space on which two places must agree; see `agreement`.
        pending: Candidates that wait for confirmation.
        confirmed: Closures that have to agree before they are accepted.
        separate: Metres between nodes whose closures confirm each other; closer ones make the same mistakes.
        together: Metres along edges between such nodes at most; further apart, drift makes them differ.
        same: Metres by which closures that agree may differ.
        same_growth: Metres by which they may differ in addition for each metre between their nodes.
        same_turn: Radians by which closures that agree may differ.
    """

    search: PlaceSearch = SEARCH
    levels: int = 6
    min_way: float = 12.0
    recent: float = 4.0
    place: float = 10.0
    min_reach: float = 0.5
    max_reach: float = 12.0
    min_turn: float = math.radians(5)
    max_turn: float = math.radians(35)
    reach_margin: float = 2.0
    min_agreement: float = 0.85
    pending: int = 12
    confirmed: int = 3
    separate: float = 1.0
    together: float = 25.0
    same: float = 0.25
    same_growth: float = 0.02
    same_turn: float = math.radians(3)


SETTINGS = LoopSettings()


@dataclass(frozen=True, slots=True)
class Candidate:
    """Closure that waits for confirmation.

    Attributes:
        new: Number of the new node.
        old: Number of the old node.
        motion: Pose of the new node in the frame of the old one.
        information: (3, 3) inverse covariance of the motion.
    """

    new: int
    old: int
    motion: Pose
    information: Matrix

    def edge(self) -> Edge:
        """Return the candidate as an edge of the graph."""
        return Edge(self.old, self.new, self.motion, self.information, closure=True)


class LoopFinder:
    """Finds loop closures by comparing new nodes with old ones that may be near.

    Candidates come from correlative scan matching (Olson, Real-Time Correlative Scan Matching, 2009) with branch and
    bound (Hess et al., Real-Time Loop Closure in 2D LIDAR SLAM, 2016), refined by a fit to normal distributions. A
    closure is accepted when the place is unambiguous, the places agree on walls and free space, and several closures
    agree on how the new nodes have to move (Olson, Recognizing Places Using Spectrally Clustered Local Matches, 2009;
    Mangelson et al., Pairwise Consistent Measurement Set Maximization for Robust Multi-Robot Map Merging, 2018).
    """

    def __init__(self, graph: PoseGraph) -> None:
        """Search the places of a graph, which may grow."""
        self._graph = graph
        self._pending: list[Candidate] = []

    def copy(self, graph: PoseGraph) -> LoopFinder:
        """Return a finder with the same pending candidates, for a copy of its graph."""
        other = LoopFinder(graph)
        other._pending = list(self._pending)
        return other

    def state(self) -> State:
        """Return the pending candidates as arrays to save."""
        return edges_state([candidate.edge() for candidate in self._pending])

    def restore(self, saved: Reader) -> None:
        """Replace the pending candidates by saved ones, after the graph was restored.

        Raises:
            InvalidRequest: The saved arrays are not candidates between nodes of the graph.
        """
        edges = restore_edges(saved, len(self._graph.nodes))
        self._pending = [Candidate(e.second, e.first, e.motion, e.information) for e in edges]

    def search(self, new: int) -> list[Edge]:
        """Return the closures that are accepted now that node `new` is complete; often none."""
        for found in self.candidates(new):
            accepted = self.confirm(found)
            if accepted:
                return accepted
        return []

    def candidates(self, new: int) -> Iterator[Candidate]:
        """Yield up to two closures of node `new`, not confirmed yet. The finder does not change."""
        distances = self._graph.distances(new)
        query: Points | None = None
        for old in self._old_nodes_near(new, distances):
            query = self._query(new) if query is None else query
            found = self._compare(new, old, query, distances[old])
            if found is not None:
                yield found

    def _old_nodes_near(self, new: int, distances: dict[int, float]) -> list[int]:
        """Return up to two old nodes that may be near a new one, the nearest first."""
        pose = self._graph.nodes[new].pose
        near = []
        for number, way in distances.items():
            if way > SETTINGS.min_way:
                other = self._graph.nodes[number].pose
                apart = math.hypot(other.x - pose.x, other.y - pose.y)
                if apart <= _reach(way) + SETTINGS.reach_margin:
                    near.append((apart, number))
        near.sort()
        # The second one is a place of its own: it shares nothing with the surroundings of the first.
        chosen = [number for _, number in near[:1]]
        for _, number in near:
            first, other = self._graph.nodes[chosen[0]].pose, self._graph.nodes[number].pose
            if math.hypot(first.x - other.x, first.y - other.y) > SETTINGS.place:
                return [*chosen, number]
        return chosen

    def _query(self, new: int) -> Points:
        """Return the points (n, 2) around a new node, in its frame."""
        return SETTINGS.search.points_in_view(np.concatenate(list(points_around(self._graph, new, SETTINGS.recent))))

    def _compare(self, new: int, old: int, query: Points, way: float) -> Candidate | None:
        """Match a new node with an old one; None if it does not fit there, or fits at several places."""
        if len(query) < SETTINGS.search.min_points:
            return None
        nodes = self._graph.nodes
        found = find_near(self._graph, old, query, nodes[old].pose.to(nodes[new].pose), way)
        if found is None:
            return None
        there = Surroundings(self._graph, old, SETTINGS.place)
        here = Surroundings(self._graph, new, SETTINGS.recent)
        if agreement(there, here, found.motion) < SETTINGS.min_agreement:
            return None
        return Candidate(new, old, found.motion, found.information)

    def confirm(self, found: Candidate) -> list[Edge]:
        """Return a new candidate and those that agree with it, if these are enough; else keep it for later."""
        near = self._graph.distances(found.new, SETTINGS.together) if self._pending else {}
        agreeing = [c for c in self._pending if self._agree(c, found, near)]
        self._pending = [*self._pending[-SETTINGS.pending + 1 :], found]
        if len({c.new for c in agreeing}) + 1 < SETTINGS.confirmed:
            return []
        self._pending = []
        return [c.edge() for c in (*agreeing, found)]

    def _agree(self, first: Candidate, second: Candidate, near: dict[int, float]) -> bool:
        """Return whether two closures move their new nodes alike; False if these are too close or too far apart."""
        nodes = self._graph.nodes
        way = nodes[first.new].pose.to(nodes[second.new].pose)
        length = math.hypot(way.x, way.y)
        if first.new == second.new or length < SETTINGS.separate:
            return False
        if first.new not in near:
            return False
        there = nodes[first.old].pose @ first.motion @ way
        off = there.to(nodes[second.old].pose @ second.motion)
        allowed = SETTINGS.same + SETTINGS.same_growth * length
        return math.hypot(off.x, off.y) < allowed and abs(off.theta) < SETTINGS.same_turn


def find_near(graph: PoseGraph, number: int, query: Points, guess: Pose, way: float) -> PlaceMatch | None:
    """Find a place around a guess, in a window as large as the drift may be.

    Args:
        graph: Graph whose places are searched.
        number: Node around which is searched.
        query: (n, 2) points seen at the place, metres, its frame.
        guess: Estimated pose of the place in the frame of the node.
        way: Metres along edges between the two, on which the estimate has drifted.

    Returns:
        The pose in the frame of the node, or None if the place does not fit there or fits at several places.
    """
    search = SETTINGS.search
    field = square_around(ORIGIN, search.view + SETTINGS.place, search.resolution)
    for points in points_around(graph, number, SETTINGS.place):
        field.add(points)
    cells, start = query / search.resolution, field.pose_to_cells(guess)
    steps = round(_reach(way) / search.resolution)
    turns = math.ceil(min(SETTINGS.min_turn + DRIFT.turn_drift * way, SETTINGS.max_turn) / search.turn)
    found = find_place(field.pyramid(SETTINGS.levels), cells, start, steps, turns, search)
    return None if found is None else refine_place(field, cells, found)


def _reach(way: float) -> float:
    """Return the metres by which an estimate may be off after `way` metres."""
    return min(SETTINGS.min_reach + DRIFT.drift * way, SETTINGS.max_reach)
