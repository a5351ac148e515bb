"""Common pose graph of robots whose maps are joined."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.grid import GridMap, OccupancyGrid
from rce.mapping.matching.agreement import Surroundings, agreement
from rce.mapping.pose_graph import loops
from rce.mapping.pose_graph.graph import Edge, PoseGraph, edges_state, restore_edges
from rce.mapping.pose_graph.loops import Candidate, LoopFinder, find_near
from rce.mapping.pose_graph.optimisation import disagreement, optimise
from rce.mapping.pose_graph.overlaps import place_points
from rce.mapping.state import Reader, State


@dataclass(frozen=True, slots=True)
class TeamSettings:
    """Settings of a common graph.

    Attributes:
        tie_distance: Metres to the place of another robot that a place is tied to at most.
        closures: New closures after which the graph is optimised.
        shifted: Metres or radians of motion of a node after which the map is rendered again.
        again: Metres by which a place has to move to be compared again.
        again_turn: Radians by which a place has to move to be compared again.
        comparisons: Number of times that a place is compared at most.
        wrong: Squared Mahalanobis distance beyond which a closure is dropped after the optimisation.
    """

    tie_distance: float = 5.0
    closures: int = 5
    shifted: float = 0.01
    again: float = 0.3
    again_turn: float = math.radians(3)
    comparisons: int = 5
    wrong: float = 50.0


SETTINGS = TeamSettings()


@dataclass(frozen=True, slots=True)
class Comparison:
    """Places that are the same as a node.

    Attributes:
        number: Number of the node in the common graph.
        candidates: Loops that are not confirmed yet.
        ties: Closures with places of other robots near by, with their names.
    """

    number: int
    candidates: list[Candidate]
    ties: list[tuple[str, Edge]]


class Team:
    """Graphs of several robots, which these still extend, as one graph in the frame of the first robot.

    Loops are searched among the places of all robots (`LoopFinder`), and each place is tied to places of the others
    near by. A place that was moved by the optimisation is compared again, since its neighbours are different now.

    Attributes:
        graph: The common graph.
    """

    def __init__(self, graphs: Mapping[str, PoseGraph], resolution: float) -> None:
        """Make the team of one robot, with its own graph, or an empty team of several (see `merged`).

        Args:
            graphs: Graph of each robot by name.
            resolution: Metres per cell of the map.
        """
        self._graphs = dict(graphs)
        self.graph = PoseGraph() if len(graphs) > 1 else next(iter(graphs.values()))
        # Number in the common graph of each node of each robot.
        self._numbers: dict[str, list[int]] = {name: [] for name in graphs}
        self._owners: list[tuple[str, int]] = []  # robot of each node, and the number that it has there
        # Edges of each robot, and how many of them were copied to the common graph.
        self._copied: dict[str, tuple[list[Edge], int]] = {}
        self._ties: list[Edge] = []  # closures between robots
        self._tied: set[tuple[int, str]] = set()  # nodes, and the robots to which they are tied
        self._loops = LoopFinder(self.graph)
        self._new_closures = 0  # number of closures since the last optimisation
        self._compared: dict[int, Pose] = {}  # pose of each node when it was compared
        self._comparisons: Counter[int] = Counter()  # number of times that each node was compared
        self._waiting: deque[int] = deque()  # nodes that are to be compared
        self._grid = GridMap(resolution)
        self._drawn: list[tuple[Pose, int]] = []  # pose of each node in the grid, and number of its sweeps there

        if len(graphs) == 1:
            self.update(self.names[0])

    @classmethod
    def merged(cls, first: Team, second: Team, shift: Pose) -> Team:
        """Return two teams as one; `shift` is the pose of the frame of the second in that of the first."""
        whole = cls({**first._graphs, **second._graphs}, first._grid.resolution)
        for team, moved in ((first, ORIGIN), (second, shift)):
            offset = len(whole._owners)
            for number, (name, own) in enumerate(team._owners):
                whole._add_node(name, own, moved @ team.graph.nodes[number].pose)
            whole._ties += [replace(e, first=e.first + offset, second=e.second + offset) for e in team._ties]
            whole._tied |= {(number + offset, other) for number, other in team._tied}
        whole._copy_all_edges()
        return whole

    def snapshot(self) -> State:
        """Return what `comparison` needs beside the graphs of the robots, as arrays."""
        names = self.names
        return {
            "owners": np.array([(names.index(name), own) for name, own in self._owners], np.int64).reshape(-1, 2),
            "poses": self.graph.poses(),
            "edges": edges_state(self.graph.edges),
            "tied": np.array([(number, names.index(name)) for number, name in self._tied], np.int64).reshape(-1, 2),
        }

    @classmethod
    def of_snapshot(cls, graphs: Mapping[str, PoseGraph], saved: Reader, resolution: float) -> Team:
        """Return a team of two or more robots that finds the same comparisons as the one that was saved.

        Args:
            graphs: Graph of each robot, in the order of `names`.
            saved: The snapshot.
            resolution: Metres per cell of the map.

        Raises:
            InvalidRequest: The arrays are not a snapshot of a team of these robots.
        """
        team, names = cls(graphs, resolution), list(graphs)
        poses = saved.poses("poses")
        for (robot, own), pose in zip(saved.indices("owners", 2**31, len(poses), 2).tolist(), poses, strict=True):
            if robot >= len(names) or own != len(team._numbers[names[robot]]) or own >= len(graphs[names[robot]].nodes):
                raise saved.invalid("owners", "do not number the nodes of the robots")
            team._add_node(names[robot], own, pose)
        team.graph.add_edges(restore_edges(saved.part("edges"), len(poses)))
        for number, robot in saved.indices("tied", max(len(poses), len(names)), None, 2).tolist():
            team._tied.add((number, names[robot % len(names)]))
        return team

    @property
    def names(self) -> list[str]:
        """Names of the robots, the one first in whose frame the graph is."""
        return list(self._graphs)

    def node_of(self, name: str, own: int) -> int:
        """Return the number, in the common graph, of node `own` of a robot."""
        return self._numbers[name][own]

    def pose(self, name: str, own: int) -> Pose:
        """Return the pose of node `own` of a robot, frame of the team."""
        return self.graph.nodes[self._numbers[name][own]].pose

    def update(self, name: str) -> None:
        """Add to the common graph what a robot has added to its own."""
        own, numbers = self._graphs[name], self._numbers[name]
        if own is self.graph:
            for number in range(len(numbers), len(own.nodes)):
                numbers.append(number)
                self._owners.append((name, number))
        elif own.edges is self._copied[name][0]:
            self._copy_edges(name)
        else:  # the list was replaced, since the robot has dropped edges
            self._copy_all_edges()

    def add_joining_edges(self, edges: list[Edge]) -> None:
        """Add the closures by which two teams became this one.

        They bring places of one team near to those of the other: all are compared again, the nearest first.
        """
        self._add_closures(edges)
        self._waiting.extend(self.graph.distances(edges[0].first))
        self.optimise()

    def compare(self, name: str, own: int) -> None:
        """Search places that are the same as node `own` of a robot: loops, and places of other robots near by."""
        if len(self._graphs) == 1:
            return  # the mapper of the robot closes its loops
        number = self._numbers[name][own]
        self._count_comparison(number)
        closures = self._loops.search(number)
        self._add_closures(closures)
        for other, tie in list(self._ties_of(number)):
            self._tie(other, tie)
        if closures or self._new_closures >= SETTINGS.closures:
            self.optimise()

    def comparison(self, number: int) -> Comparison:
        """Return what `compare` finds for a node of the common graph. The team does not change."""
        return Comparison(number, list(self._loops.candidates(number)), list(self._ties_of(number)))

    def add_comparisons(self, found: Iterable[Comparison]) -> None:
        """Add what was found for nodes that `take_waiting` has returned, and optimise."""
        for comparison in found:
            self._count_comparison(comparison.number)
            for candidate in comparison.candidates:
                closures = self._loops.confirm(candidate)
                self._add_closures(closures)
                if closures:
                    break
            for other, tie in comparison.ties:
                self._tie(other, tie)
        if self._new_closures:
            self.optimise()

    def take_waiting(self) -> list[int]:
        """Return the nodes of the common graph that are to be compared, and take them from the queue."""
        waiting = list(dict.fromkeys(self._waiting))
        self._waiting.clear()
        return waiting

    def compare_next(self) -> None:
        """Compare the next place in the queue."""
        if self._waiting:
            self.compare(*self._owners[self._waiting.popleft()])

    def settle(self) -> None:
        """Compare all places in the queue, and optimise; this may take seconds."""
        while self._waiting or self._new_closures:
            self.compare_next()
            if not self._waiting:
                self.optimise()

    def optimise(self) -> None:
        """Optimise all poses, drop ties that turn out wrong, and queue places that have moved for comparison."""
        self._new_closures = 0
        nodes = self.graph.nodes
        for number, pose in optimise(nodes, self.graph.edges).items():
            nodes[number].pose = pose
        far = zip(self._ties, disagreement(nodes, self._ties), strict=True)
        wrong = [tie for tie, off in far if tie.closure and off > SETTINGS.wrong]
        if wrong:
            self.graph.remove_edges(wrong)
            gone = {id(tie) for tie in wrong}
            self._ties = [tie for tie in self._ties if id(tie) not in gone]
        for number, before in list(self._compared.items()):
            if (
                before.to(nodes[number].pose).exceeds(SETTINGS.again, SETTINGS.again_turn)
                and self._comparisons[number] < SETTINGS.comparisons
            ):
                del self._compared[number]
                self._waiting.append(number)

    def grid(self) -> OccupancyGrid:
        """Return the map of all robots."""
        nodes = self.graph.nodes
        if any(
            np.abs(np.subtract(at, nodes[n].pose)).max() > SETTINGS.shifted for n, (at, _) in enumerate(self._drawn)
        ):
            self._grid, self._drawn = GridMap(self._grid.resolution), []
        for number, node in nodes.items():
            at, drawn = self._drawn[number] if number < len(self._drawn) else (node.pose, 0)
            for sweep in node.sweeps[drawn:]:
                self._grid.insert(*sweep.seen_from(at))
            self._drawn[number : number + 1] = [(at, len(node.sweeps))]  # append, or replace
        return self._grid.render()

    def _add_node(self, name: str, own: int, pose: Pose) -> None:
        number = self.graph.add_node(pose)
        self.graph.nodes[number].sweeps = self._graphs[name].nodes[own].sweeps  # the same list, to which the robot adds
        self._numbers[name].append(number)
        self._owners.append((name, own))

    def _copy_all_edges(self) -> None:
        """Replace the edges by those of all robots and the ties."""
        self.graph.remove_edges(self.graph.edges)
        self.graph.add_edges(self._ties)
        for name, graph in self._graphs.items():
            self._copied[name] = graph.edges, 0
            self._copy_edges(name)

    def _copy_edges(self, name: str) -> None:
        """Copy the new edges of a robot, and with them its new nodes."""
        edges, count = self._copied[name]
        numbers = self._numbers[name]
        for edge in edges[count:]:
            if edge.second == len(numbers):
                self._add_node(name, edge.second, self.pose(name, edge.first) @ edge.motion)
            self.graph.add_edges([replace(edge, first=numbers[edge.first], second=numbers[edge.second])])
            self._new_closures += edge.closure
        self._copied[name] = edges, len(edges)

    def _add_closures(self, closures: list[Edge]) -> None:
        self._ties += closures
        self.graph.add_edges(closures)
        self._new_closures += len(closures)

    def _count_comparison(self, number: int) -> None:
        self._compared[number] = self.graph.nodes[number].pose
        self._comparisons[number] += 1

    def _tie(self, other: str, tie: Edge) -> None:
        """Add a closure between a place and a place of another robot, unless that place is tied to this robot."""
        if (tie.second, other) not in self._tied:
            self._tied.add((tie.second, other))
            self._add_closures([tie])

    def _agree(self, first: tuple[str, int], second: tuple[str, int], motion: Pose) -> bool:
        """Return whether two places agree on walls and free space, with the first at `motion` in the second's frame."""
        one, other = (Surroundings(self._graphs[name], own, loops.SETTINGS.place) for name, own in (first, second))
        return agreement(other, one, motion) >= loops.SETTINGS.min_agreement

    def _ties_of(self, number: int) -> Iterator[tuple[str, Edge]]:
        """Yield closures between a node of the common graph and places of other robots near by, with their names."""
        name, own = self._owners[number]
        query = place_points(self._graphs[name], own)
        if query is not None:
            for other in self.names:
                tie = self._find_tie(number, other, query) if other != name else None
                if tie is not None:
                    yield other, tie

    def _find_tie(self, number: int, other: str, query: Points) -> Edge | None:
        """Return a closure between a place and the nearest place of another robot, if they match.

        Args:
            number: Node of the place, in the common graph.
            other: Name of the other robot.
            query: (n, 2) points seen at the place, metres, its frame.
        """
        pose = self.graph.nodes[number].pose
        apart, own = min((math.dist(self.pose(other, n)[:2], pose[:2]), n) for n in self._graphs[other].nodes)
        near = self._numbers[other][own]
        way = self.graph.distances(number, loops.SETTINGS.min_way).get(near)
        if (number, other) in self._tied or apart > SETTINGS.tie_distance or way is None:
            return None
        found = find_near(self._graphs[other], own, query, self.graph.nodes[near].pose.to(pose), way)
        if found is None or not self._agree(self._owners[number], (other, own), found.motion):
            return None
        return Edge(near, number, found.motion, found.information, closure=True)
