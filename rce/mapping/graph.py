"""The pose graph: places with what was measured there, and how they lie to each other (Lu and Milios, Globally
Consistent Range Scan Alignment for Environment Mapping, 1997)."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Points, Pose

Matrix = NDArray[np.float64]
TURN_LENGTH = 0.3  # metres of way for which a turn of one radian counts
SHORTEST = 0.1  # metres; of an edge


@dataclass(frozen=True, slots=True)
class Sweep:
    """The points (n, 2) float32 of a scan and where the laser was (1, 2), both in the frame of its node, metres."""

    sensor: Points
    points: NDArray[np.float32]


@dataclass(slots=True)
class Node:
    """A place: its pose in the map frame, and a few scans that were taken near it and move with it."""

    pose: Pose
    sweeps: list[Sweep] = field(default_factory=list)

    def points(self) -> Points:
        """All points (n, 2), metres, map frame."""
        return self.pose.transform(self.own_points())

    def own_points(self) -> Points:
        """All points (n, 2), metres, frame of the node."""
        return np.concatenate([sweep.points for sweep in self.sweeps]).astype(np.float64)


@dataclass(frozen=True, slots=True)
class Edge:
    """The pose of node `second` in the frame of node `first`, as it was measured, and the information (3, 3) about it:
    inverse covariance of x, y, theta in that frame. `closure`: it may be wrong, since another place may look alike."""

    first: int
    second: int
    motion: Pose
    information: Matrix
    closure: bool = False


class PoseGraph:
    """Nodes by number, in the order in which they were made, and edges."""

    def __init__(self) -> None:
        self.nodes: dict[int, Node] = {}
        self.edges: list[Edge] = []
        self._next = 0
        self._lengths: dict[int, dict[int, float]] = {}

    def add_node(self, pose: Pose) -> int:
        number, self._next = self._next, self._next + 1
        self.nodes[number] = Node(pose)
        self._lengths[number] = {}
        return number

    def add_edges(self, edges: Iterable[Edge]) -> None:
        for edge in edges:
            self.edges.append(edge)
            self._connect(edge)

    def remove_edges(self, edges: Iterable[Edge]) -> None:
        gone = {id(edge) for edge in edges}
        self._replace([edge for edge in self.edges if id(edge) not in gone])

    def distances(self, start: int, limit: float = math.inf) -> dict[int, float]:
        """Metres along edges from a node to those at most `limit` away, nearest first (Dijkstra, 1959)."""
        found: dict[int, float] = {}
        front = [(0.0, start)]
        while front:
            distance, number = heapq.heappop(front)
            if number in found:
                continue
            found[number] = distance
            for other, length in self._lengths[number].items():
                if other not in found and distance + length <= limit:
                    heapq.heappush(front, (distance + length, other))
        return found

    def merge(self, old: int, into: int) -> Pose:
        """Remove node `old`, whose edges `into` takes over; returns its pose in the frame of `into`.

        The pose is taken as known exactly, so the two should be close to each other.
        """
        gone = self.nodes.pop(old)
        offset = self.nodes[into].pose.to(gone.pose)
        kept = [
            edge if old not in (edge.first, edge.second) else _moved(edge, old, into, offset) for edge in self.edges
        ]
        del self._lengths[old]
        self._replace([edge for edge in kept if edge.first != edge.second])
        return offset

    def _replace(self, edges: list[Edge]) -> None:
        self.edges = edges
        for lengths in self._lengths.values():
            lengths.clear()
        for edge in edges:
            self._connect(edge)

    def _connect(self, edge: Edge) -> None:
        motion = edge.motion
        length = max(math.hypot(motion.x, motion.y) + TURN_LENGTH * abs(motion.theta), SHORTEST)
        for a, b in ((edge.first, edge.second), (edge.second, edge.first)):
            self._lengths[a][b] = min(length, self._lengths[a].get(b, math.inf))


def _moved(edge: Edge, old: int, into: int, offset: Pose) -> Edge:
    """The edge with its end `old` at `into`. `offset`: pose of `old` in the frame of `into`."""
    if edge.second == old:
        motion = edge.motion @ offset.inverse()
        lever = _lever(Pose(0.0, 0.0, edge.motion.theta).transform(-_place(offset.inverse())))
        return Edge(edge.first, into, motion, lever.T @ edge.information @ lever, edge.closure)
    turn = _rotation(offset.theta)
    return Edge(into, edge.second, offset @ edge.motion, turn @ edge.information @ turn.T, edge.closure)


def _place(pose: Pose) -> Points:
    return np.array([pose[:2]])


def _lever(arm: Points) -> Matrix:
    """How a point `arm` (1, 2) away moves with x, y, theta."""
    return np.array([[1.0, 0.0, -arm[0, 1]], [0.0, 1.0, arm[0, 0]], [0.0, 0.0, 1.0]])


def _rotation(theta: float) -> Matrix:
    c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def information_of(covariance: Matrix, theta: float, floor: tuple[float, float], scale: float) -> Matrix:
    """Information (3, 3) in a frame turned by `theta`, of a covariance of x, y, theta in the map frame.

    Points of a scan are not independent and walls are not quite where the map has them: the covariance is taken
    `scale` times, and no standard deviation as smaller than `floor` (metres, radians).
    """
    turn = _rotation(theta)
    metres, radians = floor
    whole: Matrix = scale * turn.T @ covariance @ turn + np.square(np.diag([metres, metres, radians]))
    return np.asarray(np.linalg.inv(whole), np.float64)
