"""Several robots that build one map together, though nobody knows where they started."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Pose
from rce.mapping.graph import Edge, Matrix, PoseGraph, rotation
from rce.mapping.graph_mapper import GraphMapper
from rce.mapping.grid import OccupancyGrid
from rce.mapping.joined import Team
from rce.mapping.mapper import Estimate, MapperSettings
from rce.mapping.overlaps import Match, WholeMap, place
from rce.mapping.scans import Scan

AGREE, AGREE_TURN = 0.4, math.radians(4)  # metres, radians between what two overlaps say of how two maps lie
SEPARATE = 1.5  # metres between the places of two overlaps that confirm each other
CONFIRMED = 3  # overlaps that have to agree before two maps are joined
STEP = 3  # nodes; every so many one is searched in the whole map of a robot of another team
PENDING = 30  # overlaps that wait for confirmation, for each pair of robots


@dataclass(frozen=True, slots=True)
class Overlap:
    """A place (`node`) of one robot found in the map of another: at `motion` in the frame of the other's node `near`,
    with information (3, 3) about it. Both maps may be corrected later, and the places with them."""

    node: int
    near: int
    motion: Pose
    information: Matrix


class TeamMapper:
    """Each robot maps on its own; places of one are searched in the maps of the others. When enough of them agree on
    how two maps lie to each other, the graphs are joined and optimised as one (Howard, Multi-robot Simultaneous
    Localization and Mapping using Particle Filters, 2006, for unknown starts; Mangelson et al., Pairwise Consistent
    Measurement Set Maximization for Robust Multi-Robot Map Merging, 2018, for which overlaps are believed).

    A joined robot's poses are in the frame of the first robot of its team, those of a lone one in its own.
    """

    def __init__(self, names: Iterable[str], settings: MapperSettings | None = None) -> None:
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
        """Take a robot's next scan."""
        mapper = self._mappers[name]
        own = mapper.add(scan)
        self._teams[name].follow(name)
        self._teams[name].compare_next()  # one a scan, to keep up
        while self._complete[name] < len(mapper.graph.nodes) - 1:
            self._compare(name, self._complete[name])
            self._complete[name] += 1
        team, near = self._teams[name], mapper.reference
        return replace(own, pose=team.pose(name, near) @ mapper.graph.nodes[near].pose.to(own.pose))

    def settle(self) -> None:
        """Make all comparisons that wait, and optimise: before a result is taken. It may take seconds."""
        for team in self._teams.values():
            team.settle()

    def team(self, name: str) -> list[str]:
        """The robots whose maps are joined with this one's, itself included."""
        return sorted(self._teams[name].names, key=self.names.index)

    def grid(self, name: str) -> OccupancyGrid:
        """The map of the robot's team."""
        return self._teams[name].grid()

    def trajectory(self, name: str) -> NDArray[np.float64]:
        """(n, 4) stamp, x, y, theta of each scan of the robot, frame of its team."""
        mapper, team = self._mappers[name], self._teams[name]
        return mapper.trajectory_by(np.array([team.pose(name, number) for number in mapper.graph.nodes]))

    def _compare(self, name: str, number: int) -> None:
        """Look for a place that is complete now in the team, and in the maps of all who are not in it."""
        self._teams[name].compare(name, number)
        query = None if number % STEP else place(self._mappers[name].graph, number)
        if query is None:
            return
        for other in self.names:
            graph = self._mappers[other].graph
            if other not in self._teams[name].names and len(graph.nodes) > 1:
                found = self._maps[other].find(query)
                if found is not None:
                    self._suspect(name, other, _overlap(number, graph, found))

    def _suspect(self, name: str, other: str, overlap: Overlap) -> None:
        """Join two teams once enough overlaps between them agree."""
        graphs = self._mappers[name].graph, self._mappers[other].graph
        waiting = self._overlaps.setdefault((name, other), [])
        agreeing = [each for each in waiting if _agree(*graphs, each, overlap)]
        waiting.append(overlap)
        del waiting[:-PENDING]
        if len(agreeing) + 1 >= CONFIRMED:
            self._join(name, other, [*agreeing, overlap])

    def _join(self, name: str, other: str, overlaps: list[Overlap]) -> None:
        """One team of two, laid over each other as the last overlap says."""
        ours, theirs = self._teams[name], self._teams[other]
        here = ours.pose(name, overlaps[-1].node)
        there = theirs.pose(other, overlaps[-1].near) @ overlaps[-1].motion
        if min(map(self.names.index, ours.names)) < min(map(self.names.index, theirs.names)):
            whole = Team.of(ours, theirs, here @ there.inverse())
        else:
            whole = Team.of(theirs, ours, there @ here.inverse())
        self._teams.update(dict.fromkeys(whole.names, whole))
        whole.believe(
            [
                Edge(whole.number(other, o.near), whole.number(name, o.node), o.motion, o.information, closure=True)
                for o in overlaps
            ]
        )


def _overlap(node: int, graph: PoseGraph, found: Match) -> Overlap:
    """What was found in the frame of a map, as seen from the nearest place in it."""
    near = min(graph.nodes, key=lambda each: math.dist(graph.nodes[each].pose[:2], found.motion[:2]))
    pose = graph.nodes[near].pose
    turn = rotation(pose.theta)
    return Overlap(node, near, pose.to(found.motion), turn.T @ found.information @ turn)


def _agree(own: PoseGraph, other: PoseGraph, first: Overlap, second: Overlap) -> bool:
    """Whether two overlaps, of places well apart, say the same of how the maps lie: at the place of the second."""
    one, two = own.nodes[first.node].pose, own.nodes[second.node].pose
    if math.dist(one[:2], two[:2]) < SEPARATE:
        return False
    expected = other.nodes[first.near].pose @ first.motion @ one.to(two)
    off = expected.to(other.nodes[second.near].pose @ second.motion)
    return math.hypot(off.x, off.y) < AGREE and abs(off.theta) < AGREE_TURN
