"""Least-squares optimisation of a pose graph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu

from rce.mapping.geometry import Pose, wrap_angles
from rce.mapping.pose_graph.graph import Edge, Node, PoseGraph

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class OptimiserSettings:
    """Settings of the optimisation.

    Attributes:
        iterations: Maximum number of iterations.
        tolerance: Metres or radians; a smaller step of all poses ends the iteration.
        kernel: Squared Mahalanobis distance from which on a closure counts less: the parameter Phi of dynamic
            covariance scaling.
        wrong: Squared Mahalanobis distance beyond which a closure is dropped after the optimisation.
    """

    iterations: int = 15
    tolerance: float = 1e-3
    kernel: float = 10.0
    wrong: float = 50.0


SETTINGS = OptimiserSettings()


def settle(graph: PoseGraph) -> float:
    """Move all nodes to their most likely poses, then drop closures that turn out wrong.

    Returns:
        Metres or radians by which a node has moved at most.
    """
    nodes, before = graph.nodes, graph.poses()
    for number, pose in optimise(nodes, graph.edges).items():
        nodes[number].pose = pose
    closures = [edge for edge in graph.edges if edge.closure]
    wrong = [edge for edge, off in zip(closures, disagreement(nodes, closures), strict=True) if off > SETTINGS.wrong]
    if wrong:
        graph.remove_edges(wrong)
    return float(np.abs(graph.poses() - before).max())


def optimise(nodes: Mapping[int, Node], edges: Sequence[Edge]) -> dict[int, Pose]:
    """Return the most likely poses of all nodes. The first node stays where it is.

    Network of pose constraints (Lu and Milios, 1997), solved by sparse Gauss-Newton (Grisetti et al., A Tutorial on
    Graph-Based SLAM, 2010, algorithm 1; Kümmerle et al., g2o, 2011). Closures get a robust kernel (Agarwal et al.,
    Robust Map Optimization Using Dynamic Covariance Scaling, 2013) once the iteration without it has converged: before,
    a large error of a closure may only mean that the loop is still open.

    Args:
        nodes: Nodes by number, with the poses that the iteration starts from.
        edges: Edges between these nodes.
    """
    numbers = list(nodes)
    row = {number: i for i, number in enumerate(numbers)}
    poses = np.array([nodes[number].pose for number in numbers])
    ends = np.array([(row[edge.first], row[edge.second]) for edge in edges])
    motions = np.array([edge.motion for edge in edges])
    information = np.array([edge.information for edge in edges])
    closure = np.array([edge.closure for edge in edges])
    robust = False
    for _ in range(SETTINGS.iterations):
        step = _step(poses, ends, motions, information, closure & robust)
        poses += step
        if np.abs(step).max() < SETTINGS.tolerance:
            if robust or not closure.any():
                break
            robust = True
    return {number: Pose(x, y, theta) for number, (x, y, theta) in zip(numbers, _wrapped(poses).tolist(), strict=True)}


def disagreement(nodes: Mapping[int, Node], edges: Sequence[Edge]) -> Array:
    """Return the squared Mahalanobis distance (n,) between the poses of the nodes and each edge."""
    first = np.array([nodes[edge.first].pose for edge in edges]).reshape(-1, 3)
    second = np.array([nodes[edge.second].pose for edge in edges]).reshape(-1, 3)
    error, _, _ = _errors(first, second, np.array([edge.motion for edge in edges]).reshape(-1, 3))
    information = np.array([edge.information for edge in edges]).reshape(-1, 3, 3)
    squared: Array = np.einsum("ni,nij,nj->n", error, information, error)
    return squared


def _step(poses: Array, ends: Indices, motions: Array, information: Array, robust: NDArray[np.bool_]) -> Array:
    """Return the Gauss-Newton step (nodes, 3) of all poses.

    Args:
        poses: (nodes, 3) current poses.
        ends: (n, 2) rows of `poses` that each edge connects.
        motions: (n, 3) measured motions.
        information: (n, 3, 3) information about the motions.
        robust: (n,) whether an edge has the robust kernel.
    """
    # Linearise: errors e and Jacobians J of all edges at the current poses.
    error, by_first, by_second = _errors(poses[ends[:, 0]], poses[ends[:, 1]], motions)
    squared = np.einsum("ni,nij,nj->n", error, information, error)
    # Dynamic covariance scaling: s = min(1, 2 Phi / (Phi + chi2)), and the information is scaled by s squared.
    share = np.where(robust, np.minimum(1.0, 2.0 * SETTINGS.kernel / (SETTINGS.kernel + squared)), 1.0)
    weight = information * (share**2)[:, None, None]
    jacobian = np.concatenate([by_first, by_second], axis=2)  # (n, 3, 6)
    weighted = np.einsum("nji,njk->nik", jacobian, weight)
    # Blocks of the normal equations H step = b: H = sum of J' I J, b = -sum of J' I e.
    blocks = weighted @ jacobian
    pull = -np.einsum("nij,nj->ni", weighted, error)
    # Assemble them in a sparse matrix; entries with the same index are added up.
    columns = (3 * ends[:, :, None] + np.arange(3)).reshape(-1, 6)
    size = 3 * len(poses)
    right = np.bincount(columns.ravel(), pull.ravel(), size)[3:]
    across = np.broadcast_to(columns[:, None, :], blocks.shape)
    matrix = coo_matrix((blocks.ravel(), (across.swapaxes(1, 2).ravel(), across.ravel())), (size, size)).tocsc()
    # Hold the first pose, the gauge freedom: without its rows and columns H is positive definite.
    solver = splu(matrix[3:, 3:], permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    step = np.zeros(size)
    step[3:] = solver.solve(right)
    return step.reshape(-1, 3)


def _errors(first: Array, second: Array, motions: Array) -> tuple[Array, Array, Array]:
    """Return errors (n, 3) of edges, and their Jacobians (n, 3, 3) by the first and by the second pose.

    The error is the second pose in the frame of the first, less the measured motion.
    """
    c, s = np.cos(first[:, 2]), np.sin(first[:, 2])
    dx, dy = (second - first)[:, 0], (second - first)[:, 1]
    x, y = c * dx + s * dy, c * dy - s * dx
    error = np.stack([x, y, second[:, 2] - first[:, 2]], axis=1) - motions
    zero, one = np.zeros_like(c), np.ones_like(c)
    by_first = np.stack([-c, -s, y, s, -c, -x, zero, zero, -one], axis=1).reshape(-1, 3, 3)
    by_second = np.stack([c, s, zero, -s, c, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)
    return _wrapped(error), by_first, by_second


def _wrapped(poses: Array) -> Array:
    """Return poses (n, 3) with angles in [-pi, pi)."""
    turned = poses.copy()
    turned[:, 2] = wrap_angles(poses[:, 2])
    return turned
