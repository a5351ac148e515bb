"""Joining of maps whose relative pose is unknown."""

from __future__ import annotations

import numpy as np
import pytest

from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.pose_graph.graph import Edge, PoseGraph
from rce.mapping.pose_graph.mapper import GraphMapper
from rce.mapping.pose_graph.teams import SETTINGS, Overlap, OverlapVotes, Teams, find_overlaps

INFORMATION = 1e4 * np.eye(3)
SHIFT = Pose(10.0, -3.0, 0.7)  # of the second map in the frame of the first


def line(count: int) -> PoseGraph:
    """Return a graph of places two metres apart."""
    graph = PoseGraph()
    for number in range(count):
        graph.add_node(Pose(2.0 * number, 0.0, 0.0))
        if number:
            graph.add_edges([Edge(number - 1, number, Pose(2.0, 0.0, 0.0), INFORMATION)])
    return graph


def overlap(node: int, off: Pose = ORIGIN) -> Overlap:
    """Return place `node` of the second line in the first one, near its node 0."""
    return Overlap(node, 0, SHIFT @ off @ Pose(2.0 * node, 0.0, 0.0), INFORMATION)


def test_overlaps_are_returned_once_enough_agree() -> None:
    votes = OverlapVotes(line(4), line(2))
    assert votes.add(overlap(0)) == []
    assert votes.add(overlap(1)) == []
    wrong = votes.add(overlap(2, Pose(5.0, 0.0, 0.0)))
    assert wrong == [], "two agree, the third does not"
    assert [each.node for each in votes.add(overlap(3))] == [0, 1, 3]


def test_overlaps_close_to_each_other_do_not_confirm_each_other() -> None:
    votes = OverlapVotes(line(4), line(2))
    assert all(votes.add(overlap(1)) == [] for _ in range(2 * SETTINGS.confirmed))


def test_joined_robots_share_the_frame_of_the_first() -> None:
    teams = Teams({"a": line(2), "b": line(4), "c": line(1)}, 0.05)
    assert len(list(teams)) == 3
    teams.join("b", "a", [overlap(0), overlap(1), overlap(3)])
    assert teams.are_joined("a", "b")
    assert not teams.are_joined("a", "c")
    assert (teams.members("b"), teams.members("c")) == (["a", "b"], ["c"])
    assert teams["a"] is teams["b"]
    assert tuple(teams["b"].pose("b", 0)) == pytest.approx(tuple(SHIFT))
    assert tuple(teams["b"].pose("a", 0)) == pytest.approx(tuple(ORIGIN))
    assert len(list(teams)) == 2


def test_chained_robots_keep_their_chain() -> None:
    teams = Teams({"a": line(3), "b": line(2)}, 0.05)
    teams.chain("a", "b", Edge(2, 0, Pose(1.0, 0.0, 0.0), INFORMATION))
    assert tuple(teams["a"].pose("b", 1)) == pytest.approx((7.0, 0.0, 0.0))
    team = teams["a"]
    assert team.take_waiting(), "places of one robot are near those of the other now"
    team.optimise()
    assert sum(not edge.closure for edge in team.graph.edges) == 4, "a chain is no closure that may be dropped"


def test_places_of_a_map_are_found_in_a_map_of_the_same_building(simulation: Simulation) -> None:
    mappers = GraphMapper(), GraphMapper()
    scans = simulation.records
    for mapper, part in zip(mappers, (scans, scans[len(scans) // 3 :]), strict=True):
        for scan in part:
            mapper.add(scan)
    found = find_overlaps(mappers[1].graph, mappers[0].graph)
    assert len(found) >= SETTINGS.confirmed
    truth = mappers[0].trajectory()[len(scans) // 3]
    start = mappers[0].graph.nodes[found[-1].near].pose @ found[-1].motion
    start = start @ mappers[1].graph.nodes[found[-1].node].pose.inverse()
    assert tuple(start)[:2] == pytest.approx(truth[1:3], abs=0.3)
