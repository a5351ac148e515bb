"""Pose graph along the best path, for loops that no particle closes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.matching import local_map
from rce.mapping.pose_graph import loops
from rce.mapping.pose_graph.graph import Edge, PoseGraph, Sweep
from rce.mapping.pose_graph.loops import LoopFinder
from rce.mapping.pose_graph.optimisation import settle
from rce.mapping.pose_graph.trail import Trail
from rce.mapping.state import Reader, State

Array = NDArray[np.float64]


class PathGraph:
    """Pose graph with the scans that are kept along the best path of a particle filter.

    A filter closes a loop only if one of its particles is right when the robot comes back, which after hundreds of
    metres none may be. So loops are also searched as the mapper `graph` does it (see `LoopFinder`). Where the best path
    contradicts a closure, the optimised graph tells the most likely path.

    Attributes:
        graph: Its nodes are poses of the path.
    """

    def __init__(self) -> None:
        """Start with a path at the origin."""
        self.graph = PoseGraph()
        self._trail = Trail(self.graph, self.graph.add_node(ORIGIN))
        self._loops = LoopFinder(self.graph)
        self._steps = [0]  # pose of the path that each node is
        self._places: list[int] = []  # node with which each pose of the path moves

    def sweeps(self) -> Iterator[tuple[Pose, Sweep]]:
        """Yield all scans, in the order in which they were kept, with the poses of their nodes."""
        return ((node.pose, sweep) for node in self.graph.nodes.values() for sweep in node.sweeps)

    def follow(self, path: Array) -> None:
        """Move the nodes to the poses (n, 3) of the best path, map frame, which may be another one than before."""
        if not len(path):
            return
        poses = path[self._steps]
        moved = np.flatnonzero((poses != self.graph.poses()).any(axis=1)).tolist()
        for number in moved:
            self.graph.nodes[number].pose = Pose(*poses[number].tolist())
        if moved:
            self.graph.measure_again(moved)

    def extend(self, path: Array, points: Points | None, covariance: Array) -> Array | None:
        """Add the last pose of the best path.

        Args:
            path: (n, 3) x, y, theta, metres and radians, map frame; one pose more than before.
            points: (n, 2) points seen from the last pose, metres, frame of the robot; None if they are too few.
            covariance: (3, 3) of the last pose beside those before, map frame.

        Returns:
            The corrected path (n, 3), if a loop is found that the best path does not close.
        """
        self.follow(path)
        closures: list[Edge] = []
        if points is not None:
            near = self.graph.distances(self._trail.reference, local_map.SETTINGS.way)
            complete = self._trail.advance(Pose(*path[-1].tolist()), points, covariance, near)
            self._steps += [len(path) - 1] * (len(self.graph.nodes) - len(self._steps))
            closures = [] if complete is None else self._loops.search(complete)
        self._places.append(self._trail.reference)
        self.graph.add_edges(closures)
        return self._corrected(path) if self._is_contradicted(closures) else None

    def relocate(self, pose: Pose) -> None:
        """Continue at a pose in the map frame, to which the robot was carried."""
        self._trail.relocate(pose)

    def state(self) -> State:
        """Return the graph as arrays to save."""
        return {
            "graph": self.graph.state(),
            "trail": self._trail.state(),
            "loops": self._loops.state(),
            "steps": np.array(self._steps, np.int64),
            "places": np.array(self._places, np.int64),
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
        whole._steps = saved.indices("steps", max(steps, 1), len(graph.nodes)).tolist()
        whole._places = saved.indices("places", len(graph.nodes), steps).tolist()
        return whole

    def _is_contradicted(self, closures: Sequence[Edge]) -> bool:
        """Return whether the path differs from one of the closures more than closures that agree with each other."""
        nodes, most = self.graph.nodes, loops.SETTINGS
        return any(
            edge.motion.to(nodes[edge.first].pose.to(nodes[edge.second].pose)).exceeds(most.same, most.same_turn)
            for edge in closures
        )

    def _corrected(self, path: Array) -> Array:
        """Optimise the graph; return the path along it."""
        nodes = self.graph.nodes
        relative = [nodes[place].pose.to(Pose(*pose)) for place, pose in zip(self._places, path.tolist(), strict=True)]
        settle(self.graph)
        return np.array([nodes[place].pose @ each for place, each in zip(self._places, relative, strict=True)])
