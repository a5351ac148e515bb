"""Robots whose maps are joined: their graphs as one."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from rce.mapping.agreement import Surroundings, agreement
from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.graph import Edge, PoseGraph
from rce.mapping.grid import GridMap, OccupancyGrid
from rce.mapping.loops import AGREE, KNOWN, PLACE, LoopFinder, find_near
from rce.mapping.optimisation import disagreement, optimise
from rce.mapping.overlaps import place

SEEN_FROM = 5.0  # metres to the place of another robot that a place is tied to
EVERY = 5  # closures after which all is optimised again
SHIFTED = 0.01  # metres or radians; when a node moves further, the map is rendered anew
AGAIN, AGAIN_TURN = 0.3, math.radians(3)  # a place that was moved further is compared again
TIMES = 5  # that a place is compared at most
WRONG = 50.0  # squared Mahalanobis distance; a closure that is further off after all is dropped


class Team:
    """The graphs of robots, which these still extend, as one graph, in the frame of the first robot.

    What one robot alone does about loops is done here with the places of all (`LoopFinder`), and each place is tied to
    what the others saw near by. A place that is moved by this is compared again: before, it was compared with what lies
    elsewhere.
    """

    def __init__(self, graphs: Mapping[str, PoseGraph], resolution: float) -> None:
        """Of one robot, the graph is its own; of several it is empty yet (see `of`)."""
        self._graphs = dict(graphs)
        self.graph = PoseGraph() if len(graphs) > 1 else next(iter(graphs.values()))
        self._numbers: dict[str, list[int]] = {name: [] for name in graphs}  # of the nodes here, by a robot's own
        self._owners: list[tuple[str, int]] = []  # of each node, with its own number
        self._taken: dict[str, tuple[list[Edge], int]] = {}  # a robot's edges, and how many of them are here
        self._ties: list[Edge] = []  # closures that were found here
        self._tied: set[tuple[int, str]] = set()  # nodes, and robots to a place of which they are tied
        self._loops = LoopFinder(self.graph)
        self._fresh = 0  # closures since the last optimisation
        self._compared: dict[int, Pose] = {}  # where nodes were when they were
        self._times: Counter[int] = Counter()  # that a node was compared
        self._waiting: deque[int] = deque()  # nodes to be compared
        self._grid = GridMap(resolution)
        self._drawn: list[tuple[Pose, int]] = []  # of each node that is in the grid: where, how many sweeps

        if len(graphs) == 1:
            self.follow(self.names[0])

    @classmethod
    def of(cls, first: Team, second: Team, shift: Pose) -> Team:
        """One team of two. `shift`: of the second to the frame of the first."""
        whole = cls({**first._graphs, **second._graphs}, first._grid.resolution)
        for team, moved in ((first, ORIGIN), (second, shift)):
            offset = len(whole._owners)
            for number, (name, own) in enumerate(team._owners):
                whole._add_node(name, own, moved @ team.graph.nodes[number].pose)
            whole._ties += [replace(e, first=e.first + offset, second=e.second + offset) for e in team._ties]
            whole._tied |= {(number + offset, other) for number, other in team._tied}
        whole._take_all()
        return whole

    @property
    def names(self) -> list[str]:
        return list(self._graphs)

    def number(self, name: str, own: int) -> int:
        """The node here that is a robot's node `own`."""
        return self._numbers[name][own]

    def pose(self, name: str, own: int) -> Pose:
        return self.graph.nodes[self._numbers[name][own]].pose

    def follow(self, name: str) -> None:
        """Take what a robot has added to its graph."""
        own, numbers = self._graphs[name], self._numbers[name]
        if own is self.graph:
            for number in range(len(numbers), len(own.nodes)):
                numbers.append(number)
                self._owners.append((name, number))
        elif own.edges is self._taken[name][0]:
            self._take(name)
        else:  # the robot has dropped some
            self._take_all()

    def believe(self, edges: list[Edge]) -> None:
        """Closures between two teams that have become this one: by them places of the one come near to those of the
        other, and are compared with them, the nearest first."""
        self._close(edges)
        self._waiting.extend(self.graph.distances(edges[0].first))
        self.optimise()

    def compare(self, name: str, own: int) -> None:
        """Look for places that are the same as this one: far along the edges (a loop), and of others near by."""
        if len(self._graphs) == 1:
            return  # its mapper does
        number = self._numbers[name][own]
        self._compared[number] = self.graph.nodes[number].pose
        self._times[number] += 1
        closures = self._loops.search(number)
        self._close(closures)
        query = place(self._graphs[name], own)
        if query is not None:
            self._close([tie for other in self.names if other != name for tie in self._tie(number, other, query)])
        if closures or self._fresh >= EVERY:
            self.optimise()

    def compare_next(self) -> None:
        """Compare one of the places that wait for it."""
        if self._waiting:
            self.compare(*self._owners[self._waiting.popleft()])

    def settle(self) -> None:
        """Compare all places that wait for it, and optimise; it may take seconds."""
        while self._waiting or self._fresh:
            self.compare_next()
            if not self._waiting:
                self.optimise()

    def optimise(self) -> None:
        """Find the poses on which all edges agree best."""
        self._fresh = 0
        nodes = self.graph.nodes
        for number, pose in optimise(nodes, self.graph.edges).items():
            nodes[number].pose = pose
        far = zip(self._ties, disagreement(nodes, self._ties), strict=True)
        wrong = [tie for tie, off in far if off > WRONG]
        if wrong:
            self.graph.remove_edges(wrong)
            gone = {id(tie) for tie in wrong}
            self._ties = [tie for tie in self._ties if id(tie) not in gone]
        for number, before in list(self._compared.items()):
            if before.to(nodes[number].pose).moved(AGAIN, AGAIN_TURN) and self._times[number] < TIMES:
                del self._compared[number]
                self._waiting.append(number)

    def grid(self) -> OccupancyGrid:
        """The map by what all have seen."""
        nodes = self.graph.nodes
        if any(np.abs(np.subtract(at, nodes[n].pose)).max() > SHIFTED for n, (at, _) in enumerate(self._drawn)):
            self._grid, self._drawn = GridMap(self._grid.resolution), []
        for number, node in nodes.items():
            at, drawn = self._drawn[number] if number < len(self._drawn) else (node.pose, 0)
            for sweep in node.sweeps[drawn:]:
                self._grid.insert(at.transform(sweep.sensor), at.transform(sweep.points.astype(np.float64)))
            self._drawn[number : number + 1] = [(at, len(node.sweeps))]  # one more, or the same anew
        return self._grid.render()

    def _add_node(self, name: str, own: int, pose: Pose) -> None:
        number = self.graph.add_node(pose)
        self.graph.nodes[number].sweeps = self._graphs[name].nodes[own].sweeps  # the same list: the robot adds to it
        self._numbers[name].append(number)
        self._owners.append((name, own))

    def _take_all(self) -> None:
        """Take the edges of all robots anew."""
        self.graph.remove_edges(self.graph.edges)
        self.graph.add_edges(self._ties)
        for name, graph in self._graphs.items():
            self._taken[name] = graph.edges, 0
            self._take(name)

    def _take(self, name: str) -> None:
        edges, count = self._taken[name]
        numbers = self._numbers[name]
        for edge in edges[count:]:
            if edge.second == len(numbers):
                self._add_node(name, edge.second, self.pose(name, edge.first) @ edge.motion)
            self.graph.add_edges([replace(edge, first=numbers[edge.first], second=numbers[edge.second])])
            self._fresh += edge.closure
        self._taken[name] = edges, len(edges)

    def _close(self, closures: list[Edge]) -> None:
        self._ties += closures
        self.graph.add_edges(closures)
        self._fresh += len(closures)

    def _agree(self, first: tuple[str, int], second: tuple[str, int], motion: Pose) -> bool:
        """Whether two places, by robot and its own number, agree if the first is at `motion` in the second's frame."""
        one, other = (Surroundings(self._graphs[name], own, PLACE) for name, own in (first, second))
        return agreement(other, one, motion) >= AGREE

    def _tie(self, number: int, other: str, query: Points) -> Iterator[Edge]:
        """A closure between a place, at which the points (n, 2) are seen, and the nearest one of another robot, if it
        is near along the edges too and shows the same."""
        pose = self.graph.nodes[number].pose
        apart, own = min((math.dist(self.pose(other, n)[:2], pose[:2]), n) for n in self._graphs[other].nodes)
        near = self._numbers[other][own]
        way = self.graph.distances(number, KNOWN).get(near)
        if (number, other) in self._tied or apart > SEEN_FROM or way is None:
            return
        found = find_near(self._graphs[other], own, query, self.graph.nodes[near].pose.to(pose), way)
        if found is not None and self._agree(self._owners[number], (other, own), found.motion):
            self._tied.add((number, other))
            yield Edge(near, number, found.motion, found.information, closure=True)
