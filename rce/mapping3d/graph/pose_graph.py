"""Poses of key frames and the motions measured between them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

import gtsam
import numpy as np
from numpy.typing import NDArray

from rce.mapping3d.poses import Pose, inverse, rigid

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class GraphSettings:
    """Settings of the optimisation.

    Attributes:
        shift: Standard deviation that every measured translation has at least, metres.
        turn: The same of rotations, radians.
        kernel: Mahalanobis distance from which on a loop counts less: the parameter of Cauchy's robust kernel.
        iterations: Most steps of Levenberg-Marquardt.
    """

    shift: float = 0.003
    turn: float = 0.002
    kernel: float = 3.0
    iterations: int = 30


SETTINGS = GraphSettings()


@dataclass(frozen=True, slots=True)
class Edge:
    """A measured motion.

    Attributes:
        first: Number of a node.
        second: Number of another node.
        relative: (4, 4) camera of the second to camera of the first.
        information: (6, 6) inverse covariance: translation, rotation, frame of the second.
        loop: Whether it is something else than the motion from one key frame to the next.
    """

    first: int
    second: int
    relative: Pose
    information: Floats
    loop: bool


@dataclass(slots=True)
class PoseGraph:
    """Nodes and edges; nodes that no edges connect are in different components, each with a frame of its own.

    Attributes:
        poses: (4, 4) poses of the nodes, camera to the frame of the component.
        component: The component of each node: the number of its first node.
        edges: The edges.
    """

    poses: list[Pose] = field(default_factory=list)
    component: list[int] = field(default_factory=list)
    edges: list[Edge] = field(default_factory=list)

    def add_node(self, pose: Pose, component: int | None) -> int:
        """Add a node to a component, or with None as the first of a new one; return its number."""
        number = len(self.poses)
        self.poses.append(pose)
        self.component.append(number if component is None else component)
        return number

    def add_edge(self, edge: Edge) -> None:
        """Add an edge; one between two components moves that with the larger number into the frame of the other."""
        self.edges.append(edge)
        first, second = self.component[edge.first], self.component[edge.second]
        if first == second:
            return
        expected = self.poses[edge.first] @ edge.relative
        if first < second:
            moved, into, shift = second, first, expected @ inverse(self.poses[edge.second])
        else:
            wanted = self.poses[edge.second] @ inverse(edge.relative)
            moved, into, shift = first, second, wanted @ inverse(self.poses[edge.first])
        for node, component in enumerate(self.component):
            if component == moved:
                self.poses[node] = rigid(shift @ self.poses[node])
                self.component[node] = into

    def members(self, component: int) -> list[int]:
        """Return the nodes of a component."""
        return [node for node, each in enumerate(self.component) if each == component]

    def optimise(self, component: int, free: Collection[int] | None = None) -> None:
        """Move the nodes of a component to the most likely poses. Its first node stays where it is.

        With `free` only these nodes of the component move: the time does not grow with the map then.

        Levenberg-Marquardt over the sparse graph (Dellaert and Kaess, Square Root SAM, 2006). Loops have Cauchy's
        robust kernel, so that a wrong one cannot bend the map.
        """
        graph, values = self._problem(component, free)
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setMaxIterations(SETTINGS.iterations)
        parameters.setRelativeErrorTol(1e-4)
        result = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
        for node in result.keys():  # noqa: SIM118 - gtsam's Values is no mapping
            self.poses[node] = result.atPose3(node).matrix()

    def covariance(self, node: int) -> Floats:
        """Return the marginal covariance (6, 6) of a node: translation, rotation, frame of its camera.

        It is relative to the first node of its component.
        """
        graph, values = self._problem(self.component[node], None)
        return reordered(gtsam.Marginals(graph, values).marginalCovariance(node))

    def _problem(self, component: int, free: Collection[int] | None) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        moving = set(self.members(component) if free is None else free)
        edges = [
            edge
            for edge in self.edges
            if self.component[edge.first] == component and (edge.first in moving or edge.second in moving)
        ]
        around = {end for edge in edges for end in (edge.first, edge.second)} - moving
        fixed = gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)
        for node in sorted(moving | around):
            values.insert(node, gtsam.Pose3(self.poses[node]))
            if node in around or node == component:
                graph.add(gtsam.PriorFactorPose3(node, gtsam.Pose3(self.poses[node]), fixed))
        kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(SETTINGS.kernel)
        for edge in edges:
            noise = gtsam.noiseModel.Gaussian.Covariance(reordered(covariance(edge.information)))
            model = gtsam.noiseModel.Robust.Create(kernel, noise) if edge.loop else noise
            graph.add(gtsam.BetweenFactorPose3(edge.first, edge.second, gtsam.Pose3(edge.relative), model))
        return graph, values


def covariance(information: Floats) -> Floats:
    """Return the covariance (6, 6) of a measured motion, which no measurement makes smaller than a floor.

    The errors of neighbouring pixels are not independent, and depth cameras have errors that are the same in all
    images.
    """
    floor = np.diag([SETTINGS.shift**2] * 3 + [SETTINGS.turn**2] * 3)
    weak = np.diag([1.0] * 3 + [4.0] * 3)  # of what an alignment leaves open: metres, radians
    inverted = np.linalg.inv(information + np.linalg.inv(weak)) + floor
    return np.asarray(0.5 * (inverted + inverted.T), np.float64)


def reordered(matrix: Floats) -> Floats:
    """Return a (6, 6) matrix with translation and rotation exchanged: GTSAM has the rotation first."""
    order = [3, 4, 5, 0, 1, 2]
    return np.ascontiguousarray(matrix[np.ix_(order, order)])
