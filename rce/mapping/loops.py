"""Noticing that the robot is where it has been before."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping import branching
from rce.mapping.agreement import Surroundings, agreement
from rce.mapping.fields import square_around, thin
from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.graph import DRIFT, TURN_DRIFT, Edge, Matrix, PoseGraph, around, edges_of, edges_state
from rce.mapping.overlaps import Match, refined
from rce.mapping.state import Reader, State

KNOWN = 12.0  # metres along edges; nearer nodes cannot have drifted enough to matter
RECENT, PLACE = 4.0, 10.0  # metres along edges around the new node, and around the old one, that are compared
VIEW = 15.0  # metres from the new node; points further off turn too far with a small error of the angle
DRIFT_CAP, TURN_CAP = 12.0, math.radians(35)  # by which the estimate may be off at most
LEAST_REACH, LEAST_TURN = 0.5, math.radians(5)
RESOLUTION, LEVELS, TURN = 0.1, 6, math.radians(1)
WIDTH, MOST = 0.15, 300  # of the points of the new node: metres between them, number
LEAST = 0.6  # score
FEWEST = 30  # points of the new node
BUDGET = 40_000  # poses looked at in a search
NOTHING = np.zeros(5)  # is excluded
APART, APART_TURN, RIVAL = 0.8, math.radians(10), 0.92  # another pose as good as this makes a place ambiguous
SEPARATE, TOGETHER = 1.0, 25.0  # metres, and metres along edges, between nodes whose closures confirm each other
SAME, SAME_TURN = 0.25, math.radians(3)
AGREE = 0.85  # of walls and free space, see agreement
PENDING = 12  # candidates that wait for confirmation
CONFIRMED = 3  # closures that have to agree


@dataclass(frozen=True, slots=True)
class Candidate:
    """Node `new` seems to be at `motion` in the frame of node `old`."""

    new: int
    old: int
    motion: Pose
    information: Matrix

    def edge(self) -> Edge:
        return Edge(self.old, self.new, self.motion, self.information, closure=True)


class LoopFinder:
    """Compares new nodes with old ones that the robot may be near to, by correlative scan matching (Olson, Real-Time
    Correlative Scan Matching, 2009) with branch and bound, and refines by normal distributions.

    A closure is believed when the place is unambiguous and several closures agree on how the new nodes are to move
    (Olson, Recognizing Places Using Spectrally Clustered Local Matches, 2009; Mangelson et al., Pairwise Consistent
    Measurement Set Maximization for Robust Multi-Robot Map Merging, 2018).
    """

    def __init__(self, graph: PoseGraph) -> None:
        self._graph = graph
        self._pending: list[Candidate] = []

    def state(self) -> State:
        return edges_state([candidate.edge() for candidate in self._pending])

    def restore(self, saved: Reader) -> None:
        """Into one whose graph has been restored."""
        edges = edges_of(saved, len(self._graph.nodes))
        self._pending = [Candidate(e.second, e.first, e.motion, e.information) for e in edges]

    def search(self, new: int) -> list[Edge]:
        """Closures that are believed now that node `new` is complete; often none."""
        distances = self._graph.distances(new)
        query: Points | None = None
        for old in self._places(new, distances):
            query = self._query(new) if query is None else query
            found = self._compare(new, old, query, distances[old])
            if found is not None:
                accepted = self._confirm(found, distances)
                if accepted:
                    return accepted
        return []

    def _places(self, new: int, distances: dict[int, float]) -> list[int]:
        """Up to two old nodes that may be near, the nearest first."""
        pose = self._graph.nodes[new].pose
        near = []
        for number, way in distances.items():
            if way > KNOWN:
                other = self._graph.nodes[number].pose
                apart = math.hypot(other.x - pose.x, other.y - pose.y)
                if apart <= _reach(way) + 2.0:
                    near.append((apart, number))
        near.sort()
        chosen = [number for _, number in near[:1]]
        for _, number in near:
            first, other = self._graph.nodes[chosen[0]].pose, self._graph.nodes[number].pose
            if math.hypot(first.x - other.x, first.y - other.y) > PLACE:
                return [*chosen, number]
        return chosen

    def _query(self, new: int) -> Points:
        """Points around a new node, its frame."""
        points = np.concatenate(list(around(self._graph, new, RECENT)))
        return thin(points[np.hypot(points[:, 0], points[:, 1]) < VIEW], WIDTH, MOST)

    def _compare(self, new: int, old: int, query: Points, way: float) -> Candidate | None:
        """Where the new node is, seen from an old one; None if it does not fit there, or fits at several places."""
        if len(query) < FEWEST:
            return None
        nodes = self._graph.nodes
        found = find_near(self._graph, old, query, nodes[old].pose.to(nodes[new].pose), way)
        if found is None:
            return None
        there, here = Surroundings(self._graph, old, PLACE), Surroundings(self._graph, new, RECENT)
        if agreement(there, here, found.motion) < AGREE:
            return None
        return Candidate(new, old, found.motion, found.information)

    def _confirm(self, found: Candidate, distances: dict[int, float]) -> list[Edge]:
        """The closures that agree with the new one, with it, if they are enough."""
        agreeing = [c for c in self._pending if self._agree(c, found, distances)]
        self._pending = [*self._pending[-PENDING + 1 :], found]
        if len({c.new for c in agreeing}) + 1 < CONFIRMED:
            return []
        self._pending = []
        return [c.edge() for c in (*agreeing, found)]

    def _agree(self, first: Candidate, second: Candidate, distances: dict[int, float]) -> bool:
        """Whether two closures move the new nodes by the same, so far as these are near enough to tell."""
        nodes = self._graph.nodes
        way = nodes[first.new].pose.to(nodes[second.new].pose)
        length = math.hypot(way.x, way.y)
        if first.new == second.new or length < SEPARATE or distances.get(first.new, math.inf) > TOGETHER:
            return False
        there = nodes[first.old].pose @ first.motion @ way
        off = there.to(nodes[second.old].pose @ second.motion)
        return math.hypot(off.x, off.y) < SAME + 0.02 * length and abs(off.theta) < SAME_TURN


def find_near(graph: PoseGraph, number: int, query: Points, guess: Pose, way: float) -> Match | None:
    """Where a place, at which the points (n, 2) are seen, is in the frame of a node, as far around a guess as one may
    drift on `way` metres; None if it does not fit there, or fits at several places, as in a corridor that looks the
    same all along."""
    field = square_around(ORIGIN, VIEW + PLACE, RESOLUTION)
    for points in around(graph, number, PLACE):
        field.add(points)
    pyramid, cells, start = field.pyramid(LEVELS), query / RESOLUTION, field.pose_to_cells(guess)
    x, y, theta, score = _search(pyramid, cells, start, way, LEAST, NOTHING)
    if score <= LEAST:
        return None
    excluded, rival = np.array([x, y, theta, APART / RESOLUTION, APART_TURN]), RIVAL * score
    if _search(pyramid, cells, start, way, rival, excluded)[3] != rival:
        return None  # there is one, or it takes too long to know
    return refined(field, cells, Pose(x, y, theta))


def _search(
    pyramid: NDArray[np.uint8], cells: Points, guess: Pose, way: float, least: float, excluded: NDArray[np.float64]
) -> tuple[float, float, float, float]:
    """The best pose as far around a guess as one may drift on `way` metres; see `branch_and_bound`."""
    steps = round(_reach(way) / RESOLUTION)
    turns = math.ceil(min(LEAST_TURN + TURN_DRIFT * way, TURN_CAP) / TURN)
    found = branching.branch_and_bound(pyramid, cells, *guess, steps, turns, TURN, least, excluded, BUDGET)
    x, y, theta, score = found.tolist()
    return x, y, theta, score


def _reach(way: float) -> float:
    return min(LEAST_REACH + DRIFT * way, DRIFT_CAP)
