from __future__ import annotations

import math

import numpy as np

from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.pose_graph.graph import Edge, Matrix, PoseGraph
from rce.mapping.pose_graph.optimisation import disagreement, optimise

SIDE = 10  # nodes along each side of a square
LOOSE, EXACT = np.diag([1e3, 1e3, 1e3]), np.diag([1e4, 1e4, 1e5])


def square(drift: float, information: Matrix = LOOSE) -> tuple[PoseGraph, list[Pose]]:
    """Return the graph of a drive around a square of 10 m back to its start, and the true poses.

    The odometry turns by `drift` too much at each node.
    """
    motion = [Pose(1.0, 0.0, math.pi / 2 if i % SIDE == SIDE - 1 else 0.0) for i in range(4 * SIDE)]
    graph, truth = PoseGraph(), [ORIGIN]
    estimated = ORIGIN
    graph.add_node(ORIGIN)
    for i, step in enumerate(motion):
        measured = step @ Pose(0.0, 0.0, drift)
        truth.append(truth[-1] @ step)
        estimated = estimated @ measured
        graph.add_edges([Edge(i, graph.add_node(estimated), measured, information)])
    return graph, truth


def worst(graph: PoseGraph, truth: list[Pose]) -> float:
    poses = optimise(graph.nodes, graph.edges)
    return max(math.dist(poses[i][:2], truth[i][:2]) for i in poses)


def test_closing_the_loop_corrects_the_poses() -> None:
    graph, truth = square(0.01)
    before = max(math.dist(graph.nodes[i].pose[:2], truth[i][:2]) for i in graph.nodes)
    graph.add_edges([Edge(0, 4 * SIDE, ORIGIN, EXACT, closure=True)])
    assert before > 2.0
    assert worst(graph, truth) < 0.4 * before
    assert optimise(graph.nodes, graph.edges)[0] == ORIGIN


def test_consistent_poses_do_not_change() -> None:
    graph, truth = square(0.0)
    graph.add_edges([Edge(0, 4 * SIDE, ORIGIN, EXACT, closure=True)])
    assert worst(graph, truth) < 1e-9
    assert disagreement(graph.nodes, graph.edges).max() < 1e-9


def test_false_closure_among_true_ones_has_no_effect() -> None:
    graph, truth = square(0.0, EXACT)
    true = [Edge(i, 4 * SIDE - i, truth[i].to(truth[4 * SIDE - i]), EXACT, closure=True) for i in range(5)]
    false = Edge(5, 25, truth[5].to(truth[25]) @ Pose(1.0, 1.0, 0.2), LOOSE, closure=True)
    graph.add_edges([*true, false])
    assert worst(graph, truth) < 0.05
