"""Pose graph: places with what was measured there, and measured motions between them.

Lu and Milios, Globally Consistent Range Scan Alignment for Environment Mapping, 1997.
"""

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


@dataclass(frozen=True, slots=True)
class DriftSettings:
    """Settings of how far an estimate drifts along the edges of a graph.

    Attributes:
        turn_length: Metres of way that a turn of one radian counts for.
        min_length: Metres; length of an edge at least.
        drift: Metres a metre of way by which an estimate may be off.
        turn_drift: Radians a metre of way by which an estimate may be off.
        doubt: Metres; standard deviation from which on an edge is in doubt.
        turn_doubt: Radians; the same for the heading.
        doubt_length: Metres of way, at most, that an edge in doubt counts for, so that loops are searched across it.
    """

    turn_length: float = 0.3
    min_length: float = 0.1
    drift: float = 0.05
    turn_drift: float = math.radians(0.2)
    doubt: float = 0.5
    turn_doubt: float = math.radians(5)
    doubt_length: float = 15.0


DRIFT = DriftSettings()


@dataclass(frozen=True, slots=True)
class Sweep:
    """Points of a scan, kept at a node.

    Attributes:
        sensor: (1, 2) position of the laser, metres, frame of the node.
        points: (n, 2) float32, metres, frame of the node.
    """

    sensor: Points
    points: NDArray[np.float32]

    def seen_from(self, pose: Pose) -> tuple[Points, Points]:
        """Return the laser (1, 2) and the points (n, 2), metres, in the frame in which `pose` of the node is given."""
        return pose.transform(self.sensor), pose.transform(self.points.astype(np.float64))


@dataclass(slots=True)
class Node:
    """Place with the scans that were taken near it and move with it.

    Attributes:
        pose: Pose in the map frame.
        sweeps: Scans.
    """

    pose: Pose
    sweeps: list[Sweep] = field(default_factory=list)

    def points(self) -> Points:
        """Return all points (n, 2), metres, map frame."""
        return self.pose.transform(self.own_points())

    def own_points(self) -> Points:
        """Return all points (n, 2), metres, frame of the node."""
        return np.concatenate([np.empty((0, 2)), *(sweep.points for sweep in self.sweeps)])


@dataclass(frozen=True, slots=True)
class Edge:
    """Measured motion between two nodes.

    Attributes:
        first: Number of a node.
        second: Number of another node.
        motion: Pose of the second node in the frame of the first.
        information: (3, 3) inverse covariance of x, y, theta of the motion, frame of the first node.
        closure: Whether the edge closes a loop. It may be wrong, since another place may look alike.
    """

    first: int
    second: int
    motion: Pose
    information: Matrix
    closure: bool = False


class PoseGraph:
    """Nodes and edges.

    Attributes:
        nodes: Nodes by number, in the order in which they were added.
        edges: Edges.
    """

    def __init__(self) -> None:
        """Make an empty graph."""
        self.nodes: dict[int, Node] = {}
        self.edges: list[Edge] = []
        self._lengths: dict[int, dict[int, float]] = {}

    def add_node(self, pose: Pose) -> int:
        """Add a node at a pose in the map frame; return its number."""
        number = len(self.nodes)
        self.nodes[number] = Node(pose)
        self._lengths[number] = {}
        return number

    def copy(self) -> PoseGraph:
        """Return a graph with the same nodes and edges. Scans are shared, since they do not change."""
        other = PoseGraph()
        other.nodes = {number: Node(node.pose, list(node.sweeps)) for number, node in self.nodes.items()}
        other.edges = list(self.edges)
        other._lengths = {number: dict(lengths) for number, lengths in self._lengths.items()}
        return other

    def poses(self) -> Matrix:
        """Return (nodes, 3) x, y, theta of all nodes by number, map frame."""
        return np.array([node.pose for node in self.nodes.values()]).reshape(-1, 3)

    def add_edges(self, edges: Iterable[Edge]) -> None:
        """Add edges between nodes of the graph."""
        for edge in edges:
            self.edges.append(edge)
            self._connect(edge)

    def remove_edges(self, edges: Iterable[Edge]) -> None:
        """Remove these edges, by identity."""
        gone = {id(edge) for edge in edges}
        self.edges = [edge for edge in self.edges if id(edge) not in gone]
        for lengths in self._lengths.values():
            lengths.clear()
        for edge in self.edges:
            self._connect(edge)

    def state(self) -> State:
        """Return the graph as arrays to save."""
        sweeps = [(number, sweep) for number, node in self.nodes.items() for sweep in node.sweeps]
        return {
            "poses": self.poses(),
            "places": np.array([number for number, _ in sweeps], np.int64),
            "sensors": np.array([sweep.sensor[0] for _, sweep in sweeps], np.float64).reshape(-1, 2),
            "points": pack([sweep.points for _, sweep in sweeps], np.float32),
            "edges": edges_state(self.edges),
        }

    def restore(self, saved: Reader) -> None:
        """Add the nodes and edges of a saved graph to this one, which is empty.

        Raises:
            InvalidRequest: The saved arrays are not a graph.
        """
        for pose in saved.poses("poses"):
            self.add_node(pose)
        points = saved.unpack("points", np.float32)
        places = saved.indices("places", len(self.nodes), len(points)).tolist()
        sensors = saved.array("sensors", np.float64, len(points), 2)
        for place, sensor, piece in zip(places, sensors, points, strict=True):
            self.nodes[place].sweeps.append(Sweep(sensor[None].copy(), piece))
        self.add_edges(restore_edges(saved.part("edges"), len(self.nodes)))
        if self.nodes and len(self.distances(0)) < len(self.nodes):
            raise saved.invalid("edges", "do not connect all nodes")

    def distances(self, start: int, limit: float = math.inf) -> dict[int, float]:
        """Return the metres along edges to the nodes at most `limit` away, nearest first (Dijkstra, 1959)."""
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
        way = math.hypot(motion.x, motion.y) + DRIFT.turn_length * abs(motion.theta)
        length = max(way, _doubt_length(edge.information), DRIFT.min_length)
        for a, b in ((edge.first, edge.second), (edge.second, edge.first)):
            self._lengths[a][b] = min(length, self._lengths[a].get(b, math.inf))


def _doubt_length(information: Matrix) -> float:
    """Return the metres of way on which drift grows to the uncertainty of an edge in doubt; 0 for all other edges."""
    variances = np.linalg.inv(information).diagonal()
    metres, radians = math.sqrt(variances[:2].max()), math.sqrt(variances[2])
    way = max(
        metres / DRIFT.drift if metres > DRIFT.doubt else 0.0,
        radians / DRIFT.turn_drift if radians > DRIFT.turn_doubt else 0.0,
    )
    return min(way, DRIFT.doubt_length)


def edges_state(edges: Sequence[Edge]) -> State:
    """Return edges as arrays to save."""
    return {
        "ends": np.array([(edge.first, edge.second) for edge in edges], np.int64).reshape(-1, 2),
        "motions": np.array([edge.motion for edge in edges], np.float64).reshape(-1, 3),
        "information": np.array([edge.information for edge in edges], np.float64).reshape(-1, 3, 3),
        "closures": np.array([edge.closure for edge in edges], np.bool_),
    }


def restore_edges(saved: Reader, nodes: int) -> list[Edge]:
    """Return saved edges between the first `nodes` nodes of a graph.

    Raises:
        InvalidRequest: The saved arrays are not edges.
    """
    motions = saved.poses("motions")
    ends = saved.indices("ends", nodes, len(motions), 2).tolist()
    information = saved.array("information", np.float64, len(motions), 3, 3)
    if (np.linalg.eigvalsh(information + information.swapaxes(1, 2)) <= 0).any():
        raise saved.invalid("information", "has a matrix that is not the inverse of a covariance")
    closures = saved.array("closures", np.bool_, len(motions)).tolist()
    return [
        Edge(first, second, *measured)
        for (first, second), *measured in zip(ends, motions, information, closures, strict=True)
    ]


def points_around(graph: PoseGraph, number: int, way: float) -> Iterator[Points]:
    """Yield the points of each node at most `way` metres along edges from node `number`, in the frame of that node."""
    frame = graph.nodes[number].pose
    for other in sorted(graph.distances(number, way)):
        node = graph.nodes[other]
        yield frame.to(node.pose).transform(node.own_points())


def rotation_matrix(theta: float) -> Matrix:
    """Return the matrix (3, 3) that rotates x and y and keeps the angle."""
    c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def information_matrix(covariance: Matrix, theta: float, floor: tuple[float, float], scale: float) -> Matrix:
    """Return the information (3, 3) of an edge from the covariance of a match.

    Args:
        covariance: (3, 3) of x, y, theta, map frame, as if the points of the scan were independent.
        theta: Heading of the frame of the information.
        floor: Standard deviations, metres and radians, that are added: walls are not exactly where the map has them.
        scale: Factor of the covariance, since the points are not independent.
    """
    turn = rotation_matrix(theta)
    metres, radians = floor
    whole: Matrix = scale * turn.T @ covariance @ turn + np.square(np.diag([metres, metres, radians]))
    return np.asarray(np.linalg.inv(whole), np.float64)
