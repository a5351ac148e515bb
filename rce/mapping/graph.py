"""The pose graph: places with what was measured there, and how they lie to each other (Lu and Milios, Globally
Consistent Range Scan Alignment for Environment Mapping, 1997)."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Points, Pose
from rce.mapping.state import Reader, State, pack

Matrix = NDArray[np.float64]
TURN_LENGTH = 0.3  # metres of way for which a turn of one radian counts
SHORTEST = 0.1  # metres; of an edge
DRIFT, TURN_DRIFT = 0.05, math.radians(0.2)  # metres and radians a metre of way by which an estimate may be off
UNSURE, UNSURE_TURN = 0.5, math.radians(5)  # standard deviations from which on an edge is in doubt
DOUBT = 15.0  # metres of way, at most, for which such an edge counts: loops are searched across it


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
        return np.concatenate([np.empty((0, 2)), *(sweep.points for sweep in self.sweeps)])


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
        self._lengths: dict[int, dict[int, float]] = {}

    def add_node(self, pose: Pose) -> int:
        number = len(self.nodes)
        self.nodes[number] = Node(pose)
        self._lengths[number] = {}
        return number

    def poses(self) -> Matrix:
        """(nodes, 3) x, y, theta of all nodes by number, map frame."""
        return np.array([node.pose for node in self.nodes.values()]).reshape(-1, 3)

    def add_edges(self, edges: Iterable[Edge]) -> None:
        for edge in edges:
            self.edges.append(edge)
            self._connect(edge)

    def remove_edges(self, edges: Iterable[Edge]) -> None:
        gone = {id(edge) for edge in edges}
        self.edges = [edge for edge in self.edges if id(edge) not in gone]
        for lengths in self._lengths.values():
            lengths.clear()
        for edge in self.edges:
            self._connect(edge)

    def state(self) -> State:
        sweeps = [(number, sweep) for number, node in self.nodes.items() for sweep in node.sweeps]
        return {
            "poses": self.poses(),
            "places": np.array([number for number, _ in sweeps], np.int64),
            "sensors": np.array([sweep.sensor[0] for _, sweep in sweeps], np.float64).reshape(-1, 2),
            "points": pack([sweep.points for _, sweep in sweeps], np.float32),
            "edges": edges_state(self.edges),
        }

    def restore(self, saved: Reader) -> None:
        """Into an empty graph."""
        for pose in saved.poses("poses"):
            self.add_node(pose)
        points = saved.unpack("points", np.float32)
        places = saved.indices("places", len(self.nodes), len(points)).tolist()
        sensors = saved.array("sensors", np.float64, len(points), 2)
        for place, sensor, piece in zip(places, sensors, points, strict=True):
            self.nodes[place].sweeps.append(Sweep(sensor[None].copy(), piece))
        self.add_edges(edges_of(saved.part("edges"), len(self.nodes)))

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

    def _connect(self, edge: Edge) -> None:
        motion = edge.motion
        way = math.hypot(motion.x, motion.y) + TURN_LENGTH * abs(motion.theta)
        length = max(way, _doubt(edge.information), SHORTEST)
        for a, b in ((edge.first, edge.second), (edge.second, edge.first)):
            self._lengths[a][b] = min(length, self._lengths[a].get(b, math.inf))


def _doubt(information: Matrix) -> float:
    """Metres of way for which an edge counts that is in doubt, since as much may be wrong on them; 0 for all others."""
    variances = np.linalg.inv(information).diagonal()
    metres, radians = math.sqrt(variances[:2].max()), math.sqrt(variances[2])
    way = max(metres / DRIFT if metres > UNSURE else 0.0, radians / TURN_DRIFT if radians > UNSURE_TURN else 0.0)
    return min(way, DOUBT)


def edges_state(edges: Sequence[Edge]) -> State:
    return {
        "ends": np.array([(edge.first, edge.second) for edge in edges], np.int64).reshape(-1, 2),
        "motions": np.array([edge.motion for edge in edges], np.float64).reshape(-1, 3),
        "information": np.array([edge.information for edge in edges], np.float64).reshape(-1, 3, 3),
        "closures": np.array([edge.closure for edge in edges], np.bool_),
    }


def edges_of(saved: Reader, nodes: int) -> list[Edge]:
    """`nodes`: how many there are."""
    motions = saved.poses("motions")
    ends = saved.indices("ends", nodes, len(motions), 2).tolist()
    information = saved.array("information", np.float64, len(motions), 3, 3)
    closures = saved.array("closures", np.bool_, len(motions)).tolist()
    return [
        Edge(first, second, *measured)
        for (first, second), *measured in zip(ends, motions, information, closures, strict=True)
    ]


def around(graph: PoseGraph, number: int, way: float) -> Iterator[Points]:
    """The points of each node at most `way` metres along edges from a node, in its frame."""
    frame = graph.nodes[number].pose
    for other in sorted(graph.distances(number, way)):
        node = graph.nodes[other]
        yield frame.to(node.pose).transform(node.own_points())


def rotation(theta: float) -> Matrix:
    """Of x and y; the angle stays (3, 3)."""
    c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def information_of(covariance: Matrix, theta: float, floor: tuple[float, float], scale: float) -> Matrix:
    """Information (3, 3) in a frame turned by `theta`, of a covariance of x, y, theta in the map frame.

    Points of a scan are not independent and walls are not quite where the map has them: the covariance is taken
    `scale` times, and `floor` (standard deviations, metres and radians) is added.
    """
    turn = rotation(theta)
    metres, radians = floor
    whole: Matrix = scale * turn.T @ covariance @ turn + np.square(np.diag([metres, metres, radians]))
    return np.asarray(np.linalg.inv(whole), np.float64)
