"""Pose graph along the best path, for loops that no particle closes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.matching import local_map
from rce.mapping.pose_graph import loops
from rce.mapping.pose_graph.graph import Edge, PoseGraph, Sweep
from rce.mapping.pose_graph.loops import LoopFinder
from rce.mapping.pose_graph.optimisation import optimise
from rce.mapping.pose_graph.trail import Trail
from rce.mapping.state import Reader, State

Array = NDArray[np.float64]


class PathGraph:
    """Pose graph with the scans that are kept along the best path of a particle filter.

    A filter closes a loop only if one of its particles is right when the robot comes back, which after hundreds of
    metres none may be. So loops are also searched as the mapper `graph` does it (see `LoopFinder`). Where the best path
    contradicts three closures, the optimised graph tells the most likely path.

    Attributes:
        graph: Its nodes are poses of the path.
    """

    def __init__(self) -> None:
        """Start with a path at the origin."""
        self.graph = PoseGraph()
        self._trail = Trail(self.graph, self.graph.add_node(ORIGIN))
        self._loops = LoopFinder(self.graph)
        self._closures: list[int] = []  # edges of the graph that the finder has accepted
        self._steps = [0]  # number of the pose of the path at which each node was made
        self._places: list[tuple[int, Pose]] = []  # node with which each pose moves, and the pose in its frame

    def sweeps(self) -> Iterator[tuple[Pose, Sweep]]:
        """Yield all scans, in the order in which they were kept, with the poses of their nodes."""
        return ((node.pose, sweep) for node in self.graph.nodes.values() for sweep in node.sweeps)

    def follow(self, path: Array) -> bool:
        """Move the nodes to the poses (n, 3) of the best path, map frame; return False if they are there already."""
        if not len(path):
            return False
        poses = path[self._steps]
        moved = np.flatnonzero((poses != self.graph.poses()).any(axis=1)).tolist()
        for number in moved:
            self.graph.nodes[number].pose = Pose(*poses[number].tolist())
        return bool(moved)

    def extend(self, path: Array, points: Points | None, covariance: Array) -> Array | None:
        """Add the last pose of the best path.

        Args:
            path: (n, 3) x, y, theta, metres and radians, map frame; one pose more than before.
            points: (n, 2) points seen from the last pose, metres, frame of the robot; None if they are too few.
            covariance: (3, 3) of the last pose beside those before, map frame.

        Returns:
            The corrected path (n, 3) if this one contradicts loops that were found, else None.
        """
        given = path
        if self.follow(path):
            path = self._corrected(path)  # before its last pose has a place
        closures: list[Edge] = []
        pose = Pose(*path[-1].tolist())
        if points is not None:
            near = self.graph.distances(self._trail.reference, local_map.SETTINGS.way)
            complete = self._trail.advance(pose, points, covariance, near)
            self._steps += [len(path) - 1] * (len(self.graph.nodes) - len(self._steps))
            closures = [] if complete is None else self._loops.search(complete)
        self._places.append((self._trail.reference, self._trail.relative(pose)))
        if closures:
            first = len(self.graph.edges)
            self.graph.add_edges(closures)
            self._closures += range(first, len(self.graph.edges))
            path = self._corrected(path)
        return None if path is given else path

    def relocate(self, path: Array, pose: Pose) -> None:
        """Follow the best path (n, 3), and continue at a pose in the map frame, to which the robot was carried."""
        self.follow(path)
        self._trail.relocate(pose)

    def state(self) -> State:
        """Return the graph as arrays to save."""
        return {
            "graph": self.graph.state(),
            "trail": self._trail.state(),
            "loops": self._loops.state(),
            "closures": np.array(self._closures, np.int64),
            "steps": np.array(self._steps, np.int64),
            "places": np.array([place for place, _ in self._places], np.int64),
            "relative": np.array([pose for _, pose in self._places], np.float64).reshape(-1, 3),
        }

    @classmethod
    def restored(cls, saved: Reader, steps: int) -> PathGraph:
        """Return a saved graph along a path of this many poses.

        Raises:
            InvalidRequest: The saved arrays are not such a graph.
        """
        whole = cls()
        whole.graph = graph = PoseGraph()
        graph.restore(saved.part("graph"))
        whole._trail = Trail.restored(graph, saved.part("trail"))
        whole._loops = LoopFinder(graph)
        whole._loops.restore(saved.part("loops"))
        whole._closures = saved.indices("closures", len(graph.edges), None).tolist()
        whole._steps = saved.indices("steps", max(steps, 1), len(graph.nodes)).tolist()
        places, relative = saved.indices("places", len(graph.nodes), steps).tolist(), saved.poses("relative")
        if len(relative) != len(places):
            raise saved.invalid("relative", f"has {len(relative)} poses, not {len(places)}")
        whole._places = list(zip(places, relative, strict=True))
        return whole

    def _contradicted(self, numbers: Iterable[int]) -> list[int]:
        """Return those of these edges that the path contradicts by more than `LoopSettings.same` and `same_turn`."""
        nodes, most = self.graph.nodes, loops.SETTINGS
        edges = {number: self.graph.edges[number] for number in numbers}
        return [
            number
            for number, edge in edges.items()
            if edge.motion.to(nodes[edge.first].pose.to(nodes[edge.second].pose)).exceeds(most.same, most.same_turn)
        ]

    def _corrected(self, path: Array) -> Array:
        """Return the most likely path, or the same one if it contradicts fewer closures than it takes to accept one.

        Edges may be older than this path, which may be that of another particle. So the motions between consecutive
        nodes are taken from this path, and links that it contradicts are dropped.
        """
        if len(self._contradicted(self._closures)) < loops.SETTINGS.confirmed:
            return path
        self._drop(self._contradicted(self._links()))
        nodes, edges = self.graph.nodes, self.graph.edges
        before = self._contradicted(self._closures)
        measured = [
            replace(edge, motion=nodes[edge.first].pose.to(nodes[edge.second].pose))
            if edge.second == edge.first + 1
            else edge
            for edge in edges
        ]
        for number, pose in optimise(nodes, measured).items():
            nodes[number].pose = pose
        wrong = self._contradicted([*self._closures, *self._links()])
        self._drop(wrong)
        if set(before) <= set(wrong):
            self.follow(path)
            return path
        return self._path_along(path)

    def _links(self) -> list[int]:
        """Return the edges that link nodes to those of an earlier pass."""
        closures = set(self._closures)
        return [number for number, edge in enumerate(self.graph.edges) if edge.closure and number not in closures]

    def _path_along(self, path: Array) -> Array:
        """Return the path along the nodes. A last pose without a place follows as on the given path."""
        poses = [self.graph.nodes[place].pose @ relative for place, relative in self._places]
        if len(poses) < len(path):
            before, last = (Pose(*pose) for pose in path[-2:].tolist())
            poses.append(poses[-1] @ before.to(last))
        found = np.array(poses)
        found[self._steps] = self.graph.poses()  # the same but for rounding
        return found

    def _drop(self, wrong: Sequence[int]) -> None:
        """Remove edges from the graph, and from the closures."""
        if wrong:
            edges = self.graph.edges
            left = {id(edges[number]) for number in set(self._closures) - set(wrong)}
            self.graph.remove_edges([edges[number] for number in wrong])
            self._closures = [number for number, edge in enumerate(self.graph.edges) if id(edge) in left]
