"""Nodes along the way of a robot, and the scans that are kept at them."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Points, Pose
from rce.mapping.pose_graph.graph import Edge, PoseGraph, Sweep, information_matrix
from rce.mapping.state import Reader, State, optional


@dataclass(frozen=True, slots=True)
class TrailSettings:
    """Settings of the nodes and scans that are kept.

    Attributes:
        move: Metres between scans that are kept; those between show hardly anything new.
        turn: Radians between scans that are kept.
        most: Maximum number of scans at a node; only a robot that stays there sees more.
        node_move: Metres between nodes.
        node_turn: Radians between nodes.
        link_way: Metres along edges, at least, to a node of an earlier pass that a new node is linked to.
        link_reach: Metres to such a node at most.
        floor: Standard deviations, metres and radians, that are added to those of a match; see `information_matrix`.
        link_floor: The same for a link, whose nodes were not seen one after the other.
        scale: Factor of the covariance of a match; see `information_matrix`.
    """

    move: float = 0.2
    turn: float = 0.1
    most: int = 40
    node_move: float = 1.0
    node_turn: float = 0.5
    link_way: float = 5.0
    link_reach: float = 3.0
    floor: tuple[float, float] = (0.01, math.radians(0.3))
    link_floor: tuple[float, float] = (0.03, math.radians(0.5))
    scale: float = 4.0


SETTINGS = TrailSettings()


class Trail:
    """Nodes of a pose graph along the way of a robot.

    A node is made, and scans are kept, only where no node near by looks the same way, so that memory grows with the
    building and not with time.

    Attributes:
        reference: Number of the node near the robot, with which its pose moves.
        is_open: Whether scans are kept at the reference: it is not full, and the robot has not left it yet.
    """

    def __init__(self, graph: PoseGraph, reference: int) -> None:
        """Start at a node of the graph."""
        self._graph = graph
        self.reference = reference
        self.is_open = True
        self._kept: Pose | None = None  # pose at which a scan was last considered, frame of the reference

    def copy(self, graph: PoseGraph) -> Trail:
        """Return the same trail along a copy of its graph."""
        other = copy.copy(self)
        other._graph = graph
        return other

    def relocate(self, pose: Pose) -> None:
        """Continue at the node nearest to a pose in the map frame, to which the robot was carried."""
        nodes = self._graph.nodes
        self.reference = min(nodes, key=lambda number: math.dist(nodes[number].pose[:2], pose[:2]))
        self.is_open, self._kept = False, None

    def has_moved(self, pose: Pose) -> bool:
        """Return whether a pose in the map frame is far enough from the last scan to see something new."""
        return self._kept is None or self._kept.to(self.relative(pose)).exceeds(SETTINGS.move, SETTINGS.turn)

    def relative(self, pose: Pose) -> Pose:
        """Return a pose of the map frame in the frame of the reference."""
        return self._graph.nodes[self.reference].pose.to(pose)

    def advance(
        self, pose: Pose, points: Points, covariance: NDArray[np.float64], places: Iterable[int], reliable: bool = True
    ) -> int | None:
        """Follow the robot to the scan at a pose, and keep it at the reference if that is open.

        Args:
            pose: Pose of the robot, map frame.
            points: Points (n, 2) of the scan, metres, frame of the robot.
            covariance: (3, 3) of the match of the scan, map frame.
            places: Numbers of the nodes with which the scan was matched.
            reliable: Whether the pose is certain. If not, the scan gets a node of its own.

        Returns:
            Number of the node that this completes, if any.
        """
        open_node = self.reference if self.is_open else None
        if reliable:
            self._choose_node(pose, covariance, places)
        else:
            self._open(self._add_node(pose, covariance))
        relative = self._kept = self.relative(pose)
        sweeps = self._graph.nodes[self.reference].sweeps
        self.is_open &= len(sweeps) < SETTINGS.most
        if self.is_open:
            sweeps.append(Sweep(np.array([relative[:2]]), relative.transform(points).astype(np.float32)))
        return None if self.is_open and self.reference == open_node else open_node

    def state(self) -> State:
        """Return the trail as arrays to save, without the graph."""
        return {
            "reference": np.array(self.reference, np.int64),
            "open": np.array(self.is_open),
            "kept": optional(self._kept),
        }

    @classmethod
    def restored(cls, graph: PoseGraph, saved: Reader) -> Trail:
        """Return a saved trail along a restored graph.

        Raises:
            InvalidRequest: The saved arrays are not a trail along this graph.
        """
        trail = cls(graph, saved.whole("reference", len(graph.nodes)))
        trail.is_open = bool(saved.array("open", np.bool_))
        trail._kept = saved.optional("kept")
        return trail

    def _choose_node(self, pose: Pose, covariance: NDArray[np.float64], places: Iterable[int]) -> None:
        """Set the node of the robot: the current one, another one near by, or a new one."""
        if not self.relative(pose).exceeds(SETTINGS.node_move, SETTINGS.node_turn):
            return
        near = self._nearest(pose, places)
        for _, number in near:
            if not self._graph.nodes[number].pose.to(pose).exceeds(SETTINGS.node_move, SETTINGS.node_turn):
                self.reference, self.is_open = number, False
                return
        new = self._add_node(pose, covariance)
        self._link(new, pose, covariance, near)
        self._open(new)

    def _open(self, number: int) -> None:
        self.reference, self.is_open = number, True

    def _nearest(self, pose: Pose, places: Iterable[int]) -> list[tuple[float, int]]:
        """Return the metres from a pose to each place, and its number, the nearest first."""
        return sorted((math.dist(self._graph.nodes[number].pose[:2], pose[:2]), number) for number in places)

    def _add_node(self, pose: Pose, covariance: NDArray[np.float64]) -> int:
        """Add a node with an edge from the reference; return its number.

        If the pose is in doubt, the edge is weak and counts as a long way: loops are searched with the nodes before it,
        and correct the pose.
        """
        new, before = self._graph.add_node(pose), self._graph.nodes[self.reference].pose
        information = information_matrix(covariance, before.theta, SETTINGS.floor, SETTINGS.scale)
        self._graph.add_edges([Edge(self.reference, new, before.to(pose), information)])
        return new

    def _link(self, new: int, pose: Pose, covariance: NDArray[np.float64], near: Iterable[tuple[float, int]]) -> None:
        """Add an edge to a node of an earlier pass: the scan was matched with what was seen from there, too."""
        ways = self._graph.distances(new, SETTINGS.link_way)
        apart, old = next((each for each in near if each[1] not in ways), (math.inf, -1))
        if apart < SETTINGS.link_reach:
            before = self._graph.nodes[old].pose
            information = information_matrix(covariance, before.theta, SETTINGS.link_floor, SETTINGS.scale)
            self._graph.add_edges([Edge(old, new, before.to(pose), information, closure=True)])
