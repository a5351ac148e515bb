"""Joining of maps whose relative pose is unknown, once enough overlaps agree on it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from rce.mapping.geometry import Pose
from rce.mapping.pose_graph.graph import Edge, Matrix, PoseGraph, rotation_matrix
from rce.mapping.pose_graph.overlaps import PlaceMatch, WholeMap, place_points
from rce.mapping.pose_graph.team_graph import Team


@dataclass(frozen=True, slots=True)
class JoiningSettings:
    """Settings of joining the maps of robots.

    Attributes:
        same: Metres by which the relative poses of two maps, by two overlaps that agree, may differ.
        same_turn: Radians by which they may differ.
        separate: Metres between the places of two overlaps that confirm each other; closer ones make the same mistakes.
        confirmed: Overlaps that have to agree before two maps are joined.
        every: Nodes from one that is searched in the maps of other teams to the next; a search costs much.
        pending: Overlaps that wait for confirmation, for each pair of robots.
    """

    same: float = 0.4
    same_turn: float = math.radians(4)
    separate: float = 1.5
    confirmed: int = 3
    every: int = 3
    pending: int = 30


SETTINGS = JoiningSettings()


@dataclass(frozen=True, slots=True)
class Overlap:
    """Place of one robot that was found in the map of another.

    It is relative to a node, since both maps may be corrected later, and the places with them.

    Attributes:
        node: Number of the place in the graph of the one robot.
        near: Number of the nearest node in the graph of the other robot.
        motion: Pose of the place in the frame of that node.
        information: (3, 3) inverse covariance of the motion.
    """

    node: int
    near: int
    motion: Pose
    information: Matrix


class OverlapVotes:
    """Overlaps between the maps of two robots that wait until others agree with them."""

    def __init__(self, own: PoseGraph, other: PoseGraph) -> None:
        """Collect places of one graph that were found in another."""
        self._own, self._other = own, other
        self._waiting: list[Overlap] = []

    def add(self, overlap: Overlap) -> list[Overlap]:
        """Return the overlaps that agree, the new one last, if they are enough to join the maps; else none."""
        agreeing = [each for each in self._waiting if _agree(self._own, self._other, each, overlap)]
        self._waiting = [*self._waiting[-SETTINGS.pending + 1 :], overlap]
        return [*agreeing, overlap] if len(agreeing) + 1 >= SETTINGS.confirmed else []


class Teams:
    """Robots by the maps that they share.

    Attributes:
        names: Names of all robots.
    """

    def __init__(self, graphs: Mapping[str, PoseGraph], resolution: float) -> None:
        """Make a team of each robot.

        Args:
            graphs: Graph of each robot by name. They may grow; see `Team.update`.
            resolution: Metres per cell of the maps.
        """
        self.names = list(graphs)
        self._teams = {name: Team({name: graph}, resolution) for name, graph in graphs.items()}

    def __getitem__(self, name: str) -> Team:
        """Return the team of a robot."""
        return self._teams[name]

    def __iter__(self) -> Iterator[Team]:
        """Yield each team once."""
        return iter({id(team): team for team in self._teams.values()}.values())

    def members(self, name: str) -> list[str]:
        """Return the robots whose maps are joined with that of this robot, itself included, in the order of `names`."""
        return sorted(self._teams[name].names, key=self.names.index)

    def are_joined(self, name: str, other: str) -> bool:
        """Return True if two robots share a map."""
        return self._teams[name] is self._teams[other]

    def join(self, name: str, other: str, overlaps: list[Overlap]) -> None:
        """Join the teams of two robots by places of the first in the map of the second; the last one aligns them."""
        ours, theirs = self._teams[name], self._teams[other]
        here = ours.pose(name, overlaps[-1].node)
        there = theirs.pose(other, overlaps[-1].near) @ overlaps[-1].motion
        if min(map(self.names.index, ours.names)) < min(map(self.names.index, theirs.names)):
            whole = Team.merged(ours, theirs, here @ there.inverse())
        else:
            whole = Team.merged(theirs, ours, there @ here.inverse())
        self._teams.update(dict.fromkeys(whole.names, whole))
        whole.add_joining_edges(
            [
                Edge(whole.node_of(other, o.near), whole.node_of(name, o.node), o.motion, o.information, closure=True)
                for o in overlaps
            ]
        )

    def chain(self, name: str, other: str, edge: Edge) -> None:
        """Join the teams of two robots by a measured motion from a node of the first to one of the second."""
        ours, theirs = self._teams[name], self._teams[other]
        shift = ours.pose(name, edge.first) @ edge.motion @ theirs.pose(other, edge.second).inverse()
        whole = Team.merged(ours, theirs, shift)
        self._teams.update(dict.fromkeys(whole.names, whole))
        whole.add_joining_edges(
            [replace(edge, first=whole.node_of(name, edge.first), second=whole.node_of(other, edge.second))]
        )


def find_overlaps(own: PoseGraph, other: PoseGraph) -> list[Overlap]:
    """Search places of one graph in another one, until enough of them agree.

    Returns:
        Overlaps that agree, for `Teams.join`; none if the maps do not overlap.
    """
    votes, whole = OverlapVotes(own, other), WholeMap(other)
    for number in range(0, len(own.nodes), SETTINGS.every):
        query = place_points(own, number)
        found = None if query is None else whole.find(query)
        agreeing = [] if found is None else votes.add(overlap_of(number, other, found))
        if agreeing:
            return agreeing
    return []


def overlap_of(node: int, graph: PoseGraph, found: PlaceMatch) -> Overlap:
    """Return a place that was found in a map, relative to the nearest node of that map."""
    near = min(graph.nodes, key=lambda each: math.dist(graph.nodes[each].pose[:2], found.motion[:2]))
    pose = graph.nodes[near].pose
    turn = rotation_matrix(pose.theta)
    return Overlap(node, near, pose.to(found.motion), turn.T @ found.information @ turn)


def _agree(own: PoseGraph, other: PoseGraph, first: Overlap, second: Overlap) -> bool:
    """Return whether two overlaps, of places well apart, imply the same relative pose of the maps."""
    one, two = own.nodes[first.node].pose, own.nodes[second.node].pose
    if math.dist(one[:2], two[:2]) < SETTINGS.separate:
        return False
    expected = other.nodes[first.near].pose @ first.motion @ one.to(two)
    off = expected.to(other.nodes[second.near].pose @ second.motion)
    return math.hypot(off.x, off.y) < SETTINGS.same and abs(off.theta) < SETTINGS.same_turn
