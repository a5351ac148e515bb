from __future__ import annotations

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.pose_graph.graph import PoseGraph
from rce.mapping.pose_graph.trail import SETTINGS, Trail
from rce.mapping.state import Reader, flatten

POINTS = np.array([[2.0, 0.0], [2.0, 0.5]])
CERTAIN = np.diag([1e-4, 1e-4, 1e-4])


def driven(*places: Pose) -> tuple[PoseGraph, Trail, list[int | None]]:
    """Return the graph and the trail of a robot that was at these places, and the nodes that this has completed."""
    graph = PoseGraph()
    trail = Trail(graph, graph.add_node(ORIGIN))
    completed = [trail.advance(place, POINTS, CERTAIN, list(graph.nodes)) for place in places]
    return graph, trail, completed


def along(start: float, end: float, step: float = 0.5) -> list[Pose]:
    return [Pose(float(x), 0.0, 0.0) for x in np.arange(start, end, step)]


def test_scans_are_kept_at_nodes_a_metre_apart() -> None:
    graph, trail, completed = driven(*along(0.0, 3.6))
    assert [node.pose.x for node in graph.nodes.values()] == [0.0, 1.5, 3.0]
    assert [len(node.sweeps) for node in graph.nodes.values()] == [3, 3, 2]
    assert completed == [None, None, None, 0, None, None, 1, None]
    assert [(edge.first, edge.second, edge.motion.x) for edge in graph.edges] == [(0, 1, 1.5), (1, 2, 1.5)]
    np.testing.assert_allclose(graph.nodes[1].points()[::2], [[3.5, 0.0], [4.0, 0.0], [4.5, 0.0]])
    assert trail.has_moved(Pose(3.75, 0.0, 0.0))
    assert not trail.has_moved(Pose(3.6, 0.0, 0.05))


def test_nothing_is_kept_near_a_node_of_an_earlier_pass() -> None:
    there = along(0.0, 3.6)
    graph, trail, completed = driven(*there, *there[::-1])
    assert [len(node.sweeps) for node in graph.nodes.values()] == [3, 3, 6], "four more at the last node"
    assert (trail.reference, trail.is_open) == (0, False)
    assert completed[len(there) :] == [None, None, None, None, 2, None, None, None]


def test_new_node_is_linked_to_an_earlier_pass() -> None:
    """The robot looks back on its way back, so that the nodes of its way there do not show the same."""
    there = along(0.0, 8.0)
    graph, _, _ = driven(*there, *(Pose(pose.x, 0.4, 3.0) for pose in there[::-1]))
    links = [edge for edge in graph.edges if edge.closure]
    assert len(links) == 4
    for edge in links:
        first, second = graph.nodes[edge.first].pose, graph.nodes[edge.second].pose
        assert edge.motion == pytest.approx(first.to(second))
        assert abs(first.theta - second.theta) == 3.0
        assert abs(first.x - second.x) < SETTINGS.link_reach


def test_robot_that_stays_is_not_kept_for_ever() -> None:
    graph, trail, completed = driven(*[Pose(0.3 * (i % 3), 0.0, 0.0) for i in range(3 * SETTINGS.most)])
    assert [len(node.sweeps) for node in graph.nodes.values()] == [SETTINGS.most]
    assert not trail.is_open
    assert completed == [None] * SETTINGS.most + [0] + [None] * (2 * SETTINGS.most - 1)


def test_uncertain_pose_gets_a_node_of_its_own() -> None:
    graph, trail, _ = driven(ORIGIN)
    trail.advance(Pose(0.3, 0.0, 0.0), POINTS, np.diag([1.0, 1.0, 0.5]), [0], reliable=False)
    assert (len(graph.nodes), trail.reference, trail.is_open) == (2, 1, True)
    assert graph.edges[0].information[0, 0] < 1.0


def test_carried_robot_continues_at_the_nearest_node() -> None:
    graph, trail, _ = driven(*along(0.0, 3.6))
    trail.relocate(Pose(1.3, 0.5, 0.0))
    assert (trail.reference, trail.is_open) == (1, False)
    trail.advance(Pose(1.3, 0.5, 0.0), POINTS, CERTAIN, list(graph.nodes))
    assert len(graph.nodes[1].sweeps) == 3


def test_restored_trail_continues() -> None:
    graph, trail, _ = driven(*along(0.0, 3.6))
    saved = Reader(dict(flatten(trail.state())))
    restored = Trail.restored(graph, saved)
    assert (restored.reference, restored.is_open) == (2, True)
    assert not restored.has_moved(Pose(3.6, 0.0, 0.0))
    with pytest.raises(InvalidRequest, match="reference"):
        Trail.restored(PoseGraph(), saved)
