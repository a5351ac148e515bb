"""Finding the poses at which the edges of a graph agree best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu

from rce.mapping.geometry import Pose
from rce.mapping.graph import Edge, Node

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
ITERATIONS = 15
ENOUGH = 1e-3  # metres or radians; a smaller step is the last
KERNEL = 10.0  # squared Mahalanobis distance from which a closure counts less and less


def optimise(nodes: Mapping[int, Node], edges: Sequence[Edge]) -> dict[int, Pose]:
    """The most likely poses of all nodes. The first node stays where it is.

    Sparse Gauss-Newton (Grisetti et al., A Tutorial on Graph-Based SLAM, 2010). Closures have a robust kernel
    (Agarwal et al., Robust Map Optimization Using Dynamic Covariance Scaling, 2013), once the others have been followed
    as far as they lead.
    """
    numbers = list(nodes)
    row = {number: i for i, number in enumerate(numbers)}
    poses = np.array([nodes[number].pose for number in numbers])
    ends = np.array([(row[edge.first], row[edge.second]) for edge in edges])
    motions = np.array([edge.motion for edge in edges])
    information = np.array([edge.information for edge in edges])
    closure = np.array([edge.closure for edge in edges])
    robust = False
    for _ in range(ITERATIONS):
        step = _step(poses, ends, motions, information, closure & robust)
        poses += step
        if np.abs(step).max() < ENOUGH:
            if robust or not closure.any():
                break
            robust = True
    return {number: Pose(x, y, theta) for number, (x, y, theta) in zip(numbers, _wrapped(poses).tolist(), strict=True)}


def disagreement(nodes: Mapping[int, Node], edges: Sequence[Edge]) -> Array:
    """Squared Mahalanobis distance (n,) of the poses from each edge."""
    first = np.array([nodes[edge.first].pose for edge in edges]).reshape(-1, 3)
    second = np.array([nodes[edge.second].pose for edge in edges]).reshape(-1, 3)
    error, _, _ = _errors(first, second, np.array([edge.motion for edge in edges]).reshape(-1, 3))
    information = np.array([edge.information for edge in edges]).reshape(-1, 3, 3)
    squared: Array = np.einsum("ni,nij,nj->n", error, information, error)
    return squared


def _step(poses: Array, ends: Indices, motions: Array, information: Array, robust: NDArray[np.bool_]) -> Array:
    """The Gauss-Newton step (n, 3) of all poses."""
    error, by_first, by_second = _errors(poses[ends[:, 0]], poses[ends[:, 1]], motions)
    squared = np.einsum("ni,nij,nj->n", error, information, error)
    share = np.where(robust, np.minimum(1.0, 2.0 * KERNEL / (KERNEL + squared)), 1.0)
    weight = information * (share**2)[:, None, None]
    jacobian = np.concatenate([by_first, by_second], axis=2)  # (n, 3, 6)
    weighted = np.einsum("nji,njk->nik", jacobian, weight)
    blocks = weighted @ jacobian
    pull = -np.einsum("nij,nj->ni", weighted, error)
    columns = (3 * ends[:, :, None] + np.arange(3)).reshape(-1, 6)
    size = 3 * len(poses)
    right = np.bincount(columns.ravel(), pull.ravel(), size)[3:]
    across = np.broadcast_to(columns[:, None, :], blocks.shape)
    matrix = coo_matrix((blocks.ravel(), (across.swapaxes(1, 2).ravel(), across.ravel())), (size, size)).tocsc()
    # The first pose is held: without its rows and columns the matrix is positive definite.
    solver = splu(matrix[3:, 3:], permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    step = np.zeros(size)
    step[3:] = solver.solve(right)
    return step.reshape(-1, 3)


def _errors(first: Array, second: Array, motions: Array) -> tuple[Array, Array, Array]:
    """By how much the second pose, seen from the first, is off (n, 3), with derivatives (n, 3, 3) by both poses."""
    c, s = np.cos(first[:, 2]), np.sin(first[:, 2])
    dx, dy = (second - first)[:, 0], (second - first)[:, 1]
    x, y = c * dx + s * dy, c * dy - s * dx
    error = np.stack([x, y, second[:, 2] - first[:, 2]], axis=1) - motions
    zero, one = np.zeros_like(c), np.ones_like(c)
    by_first = np.stack([-c, -s, y, s, -c, -x, zero, zero, -one], axis=1).reshape(-1, 3, 3)
    by_second = np.stack([c, s, zero, -s, c, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)
    return _wrapped(error), by_first, by_second


def _wrapped(poses: Array) -> Array:
    """The same with angles in [-pi, pi)."""
    turned = poses.copy()
    turned[:, 2] = (poses[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return turned
