from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rce.mapping3d.graph.pose_graph import Edge, PoseGraph
from rce.mapping3d.poses import Pose, angle, distance, inverse, make_pose

SURE = 1e6 * np.eye(6)
ROUGH = 1e3 * np.eye(6)
STEP = make_pose(Rotation.from_rotvec((0.0, np.radians(30.0), 0.0)).as_matrix(), (0.5, 0.0, 0.0))
TRUE = [np.linalg.matrix_power(STEP, k) for k in range(12)]  # a circle


def drifting(bias: Pose) -> PoseGraph:
    graph = PoseGraph()
    graph.add_node(np.eye(4), None)
    for k in range(1, 12):
        relative = STEP @ bias
        graph.add_node(graph.poses[-1] @ relative, 0)
        graph.add_edge(Edge(k - 1, k, relative, ROUGH, loop=False))
    return graph


BIAS = make_pose(Rotation.from_rotvec((0.0, 0.01, 0.0)).as_matrix(), (0.01, 0.0, 0.0))


def test_closed_loop_removes_the_drift() -> None:
    graph = drifting(BIAS)
    before = distance(inverse(TRUE[11]) @ graph.poses[11])
    graph.add_edge(Edge(11, 0, inverse(TRUE[11]), SURE, loop=True))
    graph.optimise(0)
    assert distance(inverse(TRUE[11]) @ graph.poses[11]) < 0.2 * before
    np.testing.assert_allclose(graph.poses[0], np.eye(4), atol=1e-6)


def test_only_free_nodes_move() -> None:
    graph = drifting(BIAS)
    before = [pose.copy() for pose in graph.poses]
    graph.add_edge(Edge(11, 8, inverse(np.linalg.matrix_power(STEP, 3)), SURE, loop=True))
    graph.optimise(0, [10, 11])
    for node in range(10):
        np.testing.assert_allclose(graph.poses[node], before[node], atol=1e-9)
    assert distance(inverse(before[11]) @ graph.poses[11]) > 0.005


def test_wrong_loop_does_not_bend_the_map() -> None:
    graph = drifting(np.eye(4))
    wrong = make_pose(np.eye(3), (2.0, 1.0, 0.0)) @ inverse(TRUE[6])
    graph.add_edge(Edge(6, 0, wrong, SURE, loop=True))
    for k in (2, 4, 9):
        graph.add_edge(Edge(0, k, TRUE[k], SURE, loop=True))
    graph.optimise(0)
    assert distance(inverse(TRUE[6]) @ graph.poses[6]) < 0.03


def test_edge_between_two_maps_moves_the_second_into_the_frame_of_the_first() -> None:
    graph = PoseGraph()
    first = graph.add_node(np.eye(4), None)
    second = graph.add_node(np.eye(4), None)
    third = graph.add_node(STEP, second)
    assert graph.component == [0, 1, 1]
    graph.add_edge(Edge(third, first, inverse(TRUE[3]), SURE, loop=True))
    assert graph.component == [0, 0, 0]
    np.testing.assert_allclose(graph.poses[third], TRUE[3], atol=1e-9)
    np.testing.assert_allclose(graph.poses[second], TRUE[2], atol=1e-9)


def test_uncertainty_grows_along_the_way_and_shrinks_with_a_loop() -> None:
    graph = drifting(np.eye(4))
    near, far = (np.sqrt(np.trace(graph.covariance(k)[:3, :3])) for k in (2, 11))
    assert near < far
    graph.add_edge(Edge(11, 0, inverse(TRUE[11]), SURE, loop=True))
    assert np.sqrt(np.trace(graph.covariance(11)[:3, :3])) < far


def test_direction_that_no_image_measured_stays_uncertain() -> None:
    graph = PoseGraph()
    graph.add_node(np.eye(4), None)
    graph.add_node(np.eye(4), 0)
    open_along_x = np.diag([0.0, 1e6, 1e6, 1e6, 1e6, 1e6])
    graph.add_edge(Edge(0, 1, np.eye(4), open_along_x, loop=False))
    sigma = np.sqrt(np.diag(graph.covariance(1)))
    assert sigma[0] > 0.9
    assert sigma[1:3] == pytest.approx([0.003, 0.003], rel=0.2)
    assert angle(graph.poses[1]) == 0.0
