"""Several robots that build one map together, though nobody knows where they started."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.graph import Edge, Matrix, Node, PoseGraph, rotation
from rce.mapping.graph_mapper import GraphMapper
from rce.mapping.grid import GridMap, OccupancyGrid
from rce.mapping.mapper import Estimate, MapperSettings
from rce.mapping.optimisation import disagreement, optimise
from rce.mapping.overlaps import Match, WholeMap, find_near, place
from rce.mapping.scans import Scan

AGREE, AGREE_TURN = 0.4, math.radians(4)  # metres, radians between what two overlaps say of how two maps lie
SEPARATE = 1.5  # metres between the places of two overlaps that confirm each other
CONFIRMED = 3  # overlaps that have to agree before two maps are joined
LATE_STEP = 2  # nodes; so many share one comparison with what was seen before two teams joined
STEP = 3  # nodes; every so many one is searched in the whole map of a robot of another team
PENDING = 30  # overlaps that wait for confirmation, for each pair of robots
SEEN_FROM = 5.0  # metres to the place of another robot that a place is tied to, once the maps are joined
EVERY = 3  # ties after which all is optimised again
SHIFTED = 0.01  # metres or radians; when a node moves further, the map is rendered anew
WRONG = 50.0  # squared Mahalanobis distance; a tie that is further off after all is dropped
STRIDE = 1_000_000  # between the numbers of two robots' nodes in the joined graph


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
        self._ties: list[Edge] = []  # between robots, by numbers of the joined graph
        self._teams = {name: [name] for name in self.names}  # each in the order of `names`
        self._placed: dict[int, Pose] = {}  # of the nodes of joined robots, at the last optimisation
        self._fresh = 0  # ties since then
        self._late: deque[tuple[str, int, str]] = deque()  # places to be compared with what another has seen before
        self._grids: dict[str, tuple[GridMap, dict[int, int]]] = {}  # by the first of a team; sweeps entered, by node

    def add(self, name: str, scan: Scan) -> Estimate:
        """Take a robot's next scan."""
        mapper = self._mappers[name]
        own = mapper.add(scan)
        if self._late:
            self._compare_late(*self._late.popleft())
        while self._complete[name] < len(mapper.graph.nodes) - 1:
            self._compare(name, self._complete[name])
            self._complete[name] += 1
        return replace(own, pose=self._in_team(name, mapper.reference, own.pose))

    def settle(self) -> None:
        """Make all comparisons that wait, and optimise: before a result is taken. It may take seconds."""
        while self._late:
            self._compare_late(*self._late.popleft())
        for team in {tuple(team) for team in self._teams.values() if len(team) > 1}:
            self._optimise(list(team))

    def team(self, name: str) -> list[str]:
        """The robots whose maps are joined with this one's, itself included."""
        return list(self._teams[name])

    def grid(self, name: str) -> OccupancyGrid:
        """The map of the robot's team."""
        team = self._teams[name]
        if len(team) == 1:
            return self._mappers[name].grid()
        if team[0] not in self._grids:
            self._grids[team[0]] = GridMap(self.settings.resolution), {}
        grid, entered = self._grids[team[0]]
        for member in team:
            for number, node in self._mappers[member].graph.nodes.items():
                known = self._number(member, number)
                pose = self._node_pose(member, number)
                for sweep in node.sweeps[entered.get(known, 0) :]:
                    grid.insert(pose.transform(sweep.sensor), pose.transform(sweep.points.astype(np.float64)))
                entered[known] = len(node.sweeps)
        return grid.render()

    def trajectory(self, name: str) -> NDArray[np.float64]:
        """(n, 4) stamp, x, y, theta of each scan of the robot, frame of its team."""
        mapper = self._mappers[name]
        return mapper.trajectory_by(np.array([self._node_pose(name, number) for number in mapper.graph.nodes]))

    # --- the frame of a team

    def _node_pose(self, name: str, number: int) -> Pose:
        return self._in_team(name, number, self._mappers[name].graph.nodes[number].pose)

    def _in_team(self, name: str, near: int, pose: Pose) -> Pose:
        """A pose of the robot's own map, as its node `near` lies in the map of the team."""
        if len(self._teams[name]) == 1:
            return pose
        nodes = self._mappers[name].graph.nodes
        while self._number(name, near) not in self._placed:  # newer than the last optimisation
            near -= 1
        return self._placed[self._number(name, near)] @ nodes[near].pose.to(pose)

    def _number(self, name: str, node: int) -> int:
        return self.names.index(name) * STRIDE + node

    # --- overlaps

    def _compare(self, name: str, number: int) -> None:
        """Look for a place that is complete now in the maps of all others."""
        query = place(self._mappers[name].graph, number)
        if query is None:
            return
        for other in self.names:
            graph = self._mappers[other].graph
            if other == name or len(graph.nodes) < 2:
                continue
            if other in self._teams[name] and self._tie_near(name, number, other, query):
                continue
            found = None if number % STEP else self._maps[other].find(query)
            if found is not None:
                self._suspect(name, other, _overlap(number, graph, found))

    def _suspect(self, name: str, other: str, overlap: Overlap) -> None:
        """Believe overlaps once enough of them agree: join two teams, or close a loop between two robots of one."""
        graphs = self._mappers[name].graph, self._mappers[other].graph
        waiting = self._overlaps.setdefault((name, other), [])
        agreeing = [each for each in waiting if _agree(*graphs, each, overlap)]
        waiting.append(overlap)
        del waiting[:-PENDING]
        if len(agreeing) + 1 < CONFIRMED:
            return
        self._overlaps[name, other] = []
        if other not in self._teams[name]:
            self._join(name, other, overlap)
        self._ties += [self._tie(name, each.node, other, each.near, each) for each in (*agreeing, overlap)]
        self._optimise(self._teams[name])

    def _join(self, name: str, other: str, overlap: Overlap) -> None:
        """One team of two, laid over each other as the overlap says."""
        ours, theirs = self._teams[name], self._teams[other]
        first, second = (theirs, ours) if self.names.index(theirs[0]) < self.names.index(ours[0]) else (ours, theirs)
        here = self._node_pose(name, overlap.node)
        there = self._node_pose(other, overlap.near) @ overlap.motion
        shift = there @ here.inverse() if first is theirs else here @ there.inverse()
        placed = {
            self._number(member, number): (shift if member in second else ORIGIN) @ self._node_pose(member, number)
            for member in (*first, *second)
            for number in self._mappers[member].graph.nodes
        }
        self._placed.update(placed)
        team = sorted((*first, *second), key=self.names.index)
        self._teams.update(dict.fromkeys(team, team))
        self._grids.clear()
        self._late += (
            (member, number, new)
            for member in first
            for new in second
            for number in range(0, self._complete[member], LATE_STEP)
        )

    def _compare_late(self, name: str, number: int, other: str) -> None:
        """Compare a place with one that the other robot saw before the two were joined; one a scan, to keep up."""
        pose = self._node_pose(name, number)
        graph = self._mappers[other].graph
        if any(math.dist(self._node_pose(other, each)[:2], pose[:2]) <= SEEN_FROM for each in graph.nodes):
            query = place(self._mappers[name].graph, number)
            if query is not None:
                self._tie_near(name, number, other, query)

    def _tie_near(self, name: str, number: int, other: str, query: NDArray[np.float64]) -> bool:
        """Tie a place to the nearest one of another robot of the team, if they see the same. Whether they do."""
        pose = self._node_pose(name, number)
        graph = self._mappers[other].graph
        apart, near = min((math.dist(self._node_pose(other, each)[:2], pose[:2]), each) for each in graph.nodes)
        if apart > SEEN_FROM:
            return False
        match = find_near(graph, near, query, self._node_pose(other, near).to(pose))
        if match is None:
            return False
        self._ties.append(self._tie(name, number, other, near, match))
        self._fresh += 1
        if self._fresh >= EVERY:
            self._optimise(self._teams[name])
        return True

    def _tie(self, name: str, number: int, other: str, near: int, seen: Match | Overlap) -> Edge:
        return Edge(self._number(other, near), self._number(name, number), seen.motion, seen.information, closure=True)

    # --- all graphs as one

    def _optimise(self, team: list[str]) -> None:
        """Find the poses on which all graphs of a team and the ties between them agree best."""
        self._fresh = 0
        nodes: dict[int, Node] = {}
        edges: list[Edge] = []
        for member in team:
            graph = self._mappers[member].graph
            nodes |= {self._number(member, n): Node(self._node_pose(member, n)) for n in graph.nodes}
            edges += [
                replace(e, first=self._number(member, e.first), second=self._number(member, e.second))
                for e in graph.edges
            ]
        ties = [tie for tie in self._ties if tie.first in nodes]
        poses = optimise(nodes, [*edges, *ties])
        for number, pose in poses.items():
            nodes[number].pose = pose
        wrong = {id(tie) for tie, off in zip(ties, disagreement(nodes, ties), strict=True) if off > WRONG}
        self._ties = [tie for tie in self._ties if id(tie) not in wrong]
        moved = (np.subtract(pose, self._placed.get(number, pose)) for number, pose in poses.items())
        if max(float(np.abs(each).max()) for each in moved) > SHIFTED:
            self._grids.clear()
        self._placed.update(poses)


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
