"""Mapper of several robots that build one map together, from unknown relative starts."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Pose
from rce.mapping.grid import OccupancyGrid
from rce.mapping.mapper import Estimate, MapperSettings
from rce.mapping.pose_graph.graph import Edge, Matrix, PoseGraph, rotation_matrix
from rce.mapping.pose_graph.mapper import GraphMapper
from rce.mapping.pose_graph.overlaps import PlaceMatch, WholeMap, place_points
from rce.mapping.pose_graph.team_graph import Team
from rce.mapping.scans import Scan


@dataclass(frozen=True, slots=True)
class TeamMapperSettings:
    """Settings of joining maps.

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


SETTINGS = TeamMapperSettings()


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


class TeamMapper:
    """Mapper of a team of robots.

    Each robot maps on its own; places of one are searched in the maps of the others. When enough overlaps agree on the
    relative pose of two maps, the graphs are joined and optimised as one. Howard, Multi-robot Simultaneous Localization
    and Mapping using Particle Filters, 2006, treats unknown starts; overlaps are accepted by pairwise consistency as in
    Mangelson et al., Pairwise Consistent Measurement Set Maximization for Robust Multi-Robot Map Merging, 2018.

    The poses of a joined robot are in the frame of the first robot of its team, those of a single one in its own.
    """

    def __init__(self, names: Iterable[str], settings: MapperSettings | None = None) -> None:
        """Start a map for each robot."""
        self.settings = settings or MapperSettings()
        self.names = list(names)
        self._mappers = {name: GraphMapper(self.settings) for name in self.names}
        self._maps = {name: WholeMap(mapper.graph) for name, mapper in self._mappers.items()}
        self._complete = dict.fromkeys(self.names, 0)  # nodes that have been compared
        self._overlaps: dict[tuple[str, str], list[Overlap]] = {}
        self._teams = {
            name: Team({name: mapper.graph}, self.settings.resolution) for name, mapper in self._mappers.items()
        }

    def add(self, name: str, scan: Scan) -> Estimate:
        """Map the next scan of a robot."""
        mapper = self._mappers[name]
        own = mapper.add(scan)
        self._teams[name].update(name)
        self._teams[name].compare_next()  # one with each scan bounds the time that a scan takes
        while self._complete[name] < len(mapper.graph.nodes) - 1:
            self._compare(name, self._complete[name])
            self._complete[name] += 1
        team, near = self._teams[name], mapper.reference
        return replace(own, pose=team.pose(name, near) @ mapper.graph.nodes[near].pose.to(own.pose))

    def settle(self) -> None:
        """Make all comparisons that wait, and optimise, before a result is read. This may take seconds."""
        for team in self._teams.values():
            team.settle()

    def team(self, name: str) -> list[str]:
        """Return the robots whose maps are joined with that of this robot, itself included."""
        return sorted(self._teams[name].names, key=self.names.index)

    def grid(self, name: str) -> OccupancyGrid:
        """Return the map of the team of a robot."""
        return self._teams[name].grid()

    def trajectory(self, name: str) -> NDArray[np.float64]:
        """Return (n, 4) stamp, x, y, theta of each scan of a robot, frame of its team."""
        mapper, team = self._mappers[name], self._teams[name]
        return mapper.trajectory_by(np.array([team.pose(name, number) for number in mapper.graph.nodes]))

    def _compare(self, name: str, number: int) -> None:
        """Search a complete place of a robot in its team, and in the maps of all robots of other teams."""
        self._teams[name].compare(name, number)
        query = None if number % SETTINGS.every else place_points(self._mappers[name].graph, number)
        if query is None:
            return
        for other in self.names:
            graph = self._mappers[other].graph
            if other not in self._teams[name].names and len(graph.nodes) > 1:
                found = self._maps[other].find(query)
                if found is not None:
                    self._add_overlap(name, other, _overlap(number, graph, found))

    def _add_overlap(self, name: str, other: str, overlap: Overlap) -> None:
        """Join two teams once enough overlaps between them agree."""
        graphs = self._mappers[name].graph, self._mappers[other].graph
        waiting = self._overlaps.setdefault((name, other), [])
        agreeing = [each for each in waiting if _agree(*graphs, each, overlap)]
        waiting.append(overlap)
        del waiting[: -SETTINGS.pending]
        if len(agreeing) + 1 >= SETTINGS.confirmed:
            self._join(name, other, [*agreeing, overlap])

    def _join(self, name: str, other: str, overlaps: list[Overlap]) -> None:
        """Join the teams of two robots; the last overlap gives their relative pose."""
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


def _overlap(node: int, graph: PoseGraph, found: PlaceMatch) -> Overlap:
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
