"""Pose graph: nodes, edges, the ways along them, and saved graphs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.pose_graph.graph import DRIFT, Edge, Matrix, Node, PoseGraph, Sweep, information_matrix, points_around
from rce.mapping.state import Reader, flatten

PRECISE = 1e4 * np.eye(3)  # information of an edge: a centimetre, half a degree
STEP = Pose(1.0, 0.0, 0.0)


def chain(count: int) -> PoseGraph:
    """Return nodes a metre apart along x, each with one point a metre to its left."""
    graph = PoseGraph()
    for i in range(count):
        number = graph.add_node(Pose(float(i), 0.0, 0.0))
        graph.nodes[number].sweeps.append(Sweep(np.zeros((1, 2)), np.array([[0.0, 1.0]], np.float32)))
        if i:
            graph.add_edges([Edge(i - 1, i, STEP, PRECISE)])
    return graph


def test_points_of_a_node_move_with_it() -> None:
    node = Node(Pose(5.0, 0.0, math.pi / 2), [Sweep(np.array([[0.5, 0.0]]), np.array([[1.0, 0.0]], np.float32))] * 2)
    np.testing.assert_allclose(node.own_points(), [[1.0, 0.0]] * 2)
    np.testing.assert_allclose(node.points(), [[5.0, 1.0]] * 2, atol=1e-12)
    sensor, points = node.sweeps[0].seen_from(node.pose)
    np.testing.assert_allclose(sensor, [[5.0, 0.5]], atol=1e-12)
    np.testing.assert_allclose(points, [[5.0, 1.0]], atol=1e-12)


def test_node_without_sweeps_has_no_points() -> None:
    assert Node(ORIGIN).points().shape == (0, 2)


def test_empty_graph_has_no_poses() -> None:
    assert PoseGraph().poses().shape == (0, 3)


def test_distances_are_along_edges_nearest_first() -> None:
    graph = chain(12)
    ways = graph.distances(5, 3.5)
    assert list(ways.values()) == sorted(ways.values())
    assert ways == {2: 3.0, 3: 2.0, 4: 1.0, 5: 0.0, 6: 1.0, 7: 2.0, 8: 3.0}
    graph.add_edges([Edge(0, 11, ORIGIN, PRECISE, closure=True)])
    assert graph.distances(1)[10] == pytest.approx(1.0 + DRIFT.min_length + 1.0)
    graph.remove_edges([graph.edges[-1]])
    assert graph.distances(1)[10] == pytest.approx(9.0)


def test_turn_counts_as_a_way_and_the_shorter_of_two_edges_counts() -> None:
    graph = PoseGraph()
    for _ in range(2):
        graph.add_node(ORIGIN)
    graph.add_edges([Edge(0, 1, Pose(3.0, 0.0, 0.0), PRECISE)])
    graph.add_edges([Edge(1, 0, Pose(0.0, 0.0, -2.0), PRECISE)])
    assert graph.distances(0)[1] == pytest.approx(2.0 * DRIFT.turn_length)
    graph.add_edges([Edge(0, 1, Pose(0.3, 0.4, 0.0), PRECISE), Edge(0, 1, Pose(2.0, 0.0, 0.0), PRECISE)])
    assert graph.distances(0)[1] == pytest.approx(0.5)


def test_edge_in_doubt_counts_as_a_long_way() -> None:
    graph = PoseGraph()
    for x in range(3):
        graph.add_node(Pose(float(x), 0.0, 0.0))
    sideways = np.diag([1.0 / 0.8**2, 1e4, 1e4])
    graph.add_edges([Edge(0, 1, Pose(1.0, 0.0, 0.0), PRECISE), Edge(1, 2, Pose(1.0, 0.0, 0.0), sideways)])
    assert graph.distances(0)[1] == pytest.approx(1.0)
    assert graph.distances(1)[2] == pytest.approx(DRIFT.doubt_length)


def test_edges_are_removed_by_identity() -> None:
    graph = chain(2)
    twin = Edge(0, 1, STEP, PRECISE)
    graph.add_edges([twin])
    graph.remove_edges([twin])
    assert len(graph.edges) == 1
    assert graph.distances(0)[1] == 1.0
    graph.remove_edges(graph.edges)
    assert graph.distances(0) == {0: 0.0}


def test_points_around_a_node_are_in_its_frame() -> None:
    points = np.concatenate(list(points_around(chain(5), 2, 1.5)))
    np.testing.assert_allclose(points, [[-1.0, 1.0], [0.0, 1.0], [1.0, 1.0]])


def test_copied_graph_grows_and_moves_by_itself() -> None:
    graph = chain(3)
    other = graph.copy()
    other.add_edges([Edge(2, other.add_node(Pose(3.0, 0.0, 0.0)), STEP, PRECISE)])
    other.nodes[1].pose = Pose(1.0, 5.0, 0.0)
    other.nodes[0].sweeps.clear()
    assert (len(graph.nodes), len(graph.edges), graph.nodes[1].pose.y, len(graph.nodes[0].sweeps)) == (3, 2, 0.0, 1)
    assert list(other.distances(0, 9.0)) == [0, 1, 2, 3]
    assert list(graph.distances(0, 9.0)) == [0, 1, 2]


def test_restored_graph_is_the_same() -> None:
    graph, other = chain(4), PoseGraph()
    graph.nodes[1].sweeps.append(Sweep(np.array([[0.1, 0.2]]), np.empty((0, 2), np.float32)))
    graph.add_edges([Edge(3, 0, Pose(-3.0, 0.1, 0.2), 2 * PRECISE, closure=True)])
    other.restore(Reader(dict(flatten(graph.state()))))
    np.testing.assert_array_equal(other.poses(), graph.poses())
    assert [len(node.sweeps) for node in other.nodes.values()] == [1, 2, 1, 1]
    np.testing.assert_array_equal(other.nodes[1].sweeps[1].sensor, [[0.1, 0.2]])
    assert [(e.first, e.second, e.motion, e.closure) for e in other.edges] == [
        (e.first, e.second, e.motion, e.closure) for e in graph.edges
    ]
    np.testing.assert_array_equal(other.edges[-1].information, 2 * PRECISE)
    assert other.distances(0) == graph.distances(0)


@pytest.mark.parametrize(
    "matrix", [np.zeros((3, 3)), -PRECISE, np.diag([1.0, -1.0, 1.0])], ids=["zero", "negative", "indefinite"]
)
def test_information_that_is_no_inverse_covariance_is_refused(matrix: Matrix) -> None:
    state = dict(flatten(chain(3).state()))
    state["edges/information"][1] = matrix
    with pytest.raises(InvalidRequest, match="edges/information has a matrix that is not the inverse of a covariance"):
        PoseGraph().restore(Reader(state))


def test_graph_in_two_parts_is_refused() -> None:
    state = dict(flatten(chain(4).state()))
    state["edges/ends"][1] = 0, 1
    with pytest.raises(InvalidRequest, match="edges do not connect all nodes"):
        PoseGraph().restore(Reader(state))


@pytest.mark.parametrize("name", ["places", "edges/ends"])
def test_state_that_refers_to_missing_nodes_is_refused(name: str) -> None:
    state = dict(flatten(chain(3).state()))
    state[name] = np.where(state[name] == 2, 3, state[name])
    with pytest.raises(InvalidRequest, match=name):
        PoseGraph().restore(Reader(state))


def test_information_is_rotated_and_bounded() -> None:
    along_x = np.diag([1.0, 1e-8, 1e-8])
    information = information_matrix(along_x, math.pi / 2, (0.1, 0.01), 1.0)
    np.testing.assert_allclose(np.diag(information), [100.0, 1 / 1.01, 1e4], rtol=1e-3)
