from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from rce.mapping.evaluation.simulation.floor_plan import FloorPlan, apartment
from rce.mapping.geometry import Pose
from rce.mapping.pose_graph.graph import Edge, PoseGraph
from rce.mapping.pose_graph.loops import SETTINGS, LoopFinder
from tests.support.laser import sweep_at

ROOM = [(1.2 + 1.1 * i, 2.4) for i in range(4)]  # places that the robot visits twice
FAR = 100.0  # metres of way between the visits
PRECISE = 1e4 * np.eye(3)  # information of an edge: a centimetre, half a degree


def graph_of(places: list[Pose], offset: Pose, plan: FloorPlan) -> PoseGraph:
    """Return a graph with nodes at `places`, and after a long way the same nodes with poses off by `offset`."""
    graph = PoseGraph()
    for pose in (*places, *places):
        second = len(graph.nodes) >= len(places)
        number = graph.add_node(offset @ pose if second else pose)
        graph.nodes[number].sweeps.append(sweep_at(pose, plan))
    for i, j in pairwise(graph.nodes):
        way = graph.nodes[i].pose.to(graph.nodes[j].pose)
        graph.add_edges([Edge(i, j, Pose(FAR, 0.0, 0.0) if j == len(places) else way, PRECISE)])
    return graph


def search(graph: PoseGraph, count: int) -> list[list[Edge]]:
    finder = LoopFinder(graph)
    return [finder.search(number) for number in list(graph.nodes)[count:]]


@pytest.mark.parametrize("offset", [Pose(0.1, 0.0, 0.0), Pose(1.2, -0.8, 0.2)], ids=["near", "far"])
def test_place_is_recognised_once_enough_closures_agree(offset: Pose) -> None:
    places = [Pose(x, y, 0.3) for x, y in ROOM]
    found = search(graph_of(places, offset, apartment()), len(places))
    assert [len(edges) for edges in found[: SETTINGS.confirmed]] == [0] * (SETTINGS.confirmed - 1) + [
        SETTINGS.confirmed
    ]
    for edge in found[SETTINGS.confirmed - 1]:
        truth = places[edge.first].to(places[edge.second - len(places)])
        assert edge.closure
        assert edge.motion == pytest.approx(truth, abs=0.03)


def test_copied_finder_has_the_pending_closures() -> None:
    places = [Pose(x, y, 0.3) for x, y in ROOM]
    graph = graph_of(places, Pose(0.1, 0.0, 0.0), apartment())
    finder, numbers = LoopFinder(graph), list(graph.nodes)[len(places) :]
    for number in numbers[: SETTINGS.confirmed - 1]:
        assert not finder.search(number)
    last = numbers[SETTINGS.confirmed - 1]
    assert len(finder.copy(graph.copy()).search(last)) == SETTINGS.confirmed
    assert len(finder.search(last)) == SETTINGS.confirmed, "the copy has taken nothing from it"


def test_corridor_without_ends_is_ambiguous() -> None:
    walls = np.array([[[-500.0, y], [500.0, y]] for y in (-1.0, 1.0)])
    places = [Pose(0.9 * i, 0.0, 0.0) for i in range(5)]
    assert not any(search(graph_of(places, Pose(0.5, 0.0, 0.0), FloorPlan(walls)), len(places)))


def test_different_place_is_not_recognised() -> None:
    plan = apartment()
    places = [Pose(x, y, 0.3) for x, y in ROOM]
    graph = graph_of(places, Pose(0.2, 0.0, 0.0), plan)
    elsewhere = [Pose(x + 8.0, y, 2.0) for x, y in ROOM]
    for number, pose in zip(range(len(places), 2 * len(places)), elsewhere, strict=True):
        graph.nodes[number].sweeps = [sweep_at(pose, plan)]
    assert not any(search(graph, len(places)))


def test_nodes_near_along_edges_are_not_searched() -> None:
    places = [Pose(x, y, 0.3) for x, y in ROOM]
    graph = graph_of(places, Pose(0.1, 0.0, 0.0), apartment())
    graph.add_edges([Edge(0, len(places), Pose(0.1, 0.0, 0.0), PRECISE)])
    assert not any(search(graph, len(places)))
