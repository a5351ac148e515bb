"""Tests of parts and results as bytes."""

from __future__ import annotations

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.grid import OccupancyGrid
from rce.mapping.parallel.states import (
    PartMap,
    SeedMap,
    pack_comparisons,
    pack_overlaps,
    pack_state,
    unpack_comparisons,
    unpack_overlaps,
    unpack_state,
)
from rce.mapping.pose_graph.graph import Edge, PoseGraph
from rce.mapping.pose_graph.loops import Candidate
from rce.mapping.pose_graph.mapper import GraphMapper
from rce.mapping.pose_graph.team_graph import Comparison
from rce.mapping.pose_graph.teams import Overlap

MOTION, INFORMATION = Pose(1.0, 2.0, 0.5), np.diag([4.0, 5.0, 6.0])


def graph(nodes: int) -> PoseGraph:
    graph = PoseGraph()
    for _ in range(nodes):
        graph.add_node(ORIGIN)
    return graph


def test_part_survives_packing(simulation: Simulation) -> None:
    mapper = GraphMapper()
    for scan in simulation.records[:60]:
        mapper.add(scan)
    part = PartMap.unpack(PartMap(mapper.graph, mapper.history).pack())
    assert np.array_equal(part.graph.poses(), mapper.graph.poses())
    assert len(part.graph.edges) == len(mapper.graph.edges)
    assert [len(node.sweeps) for node in part.graph.nodes.values()] == [
        len(node.sweeps) for node in mapper.graph.nodes.values()
    ]
    assert np.array_equal(part.history.trajectory(part.graph.poses()), mapper.trajectory())


def test_map_of_a_seed_survives_packing() -> None:
    cells = np.array([[-1, 0, 51], [100, 50, 3]], np.int8)
    before = SeedMap(OccupancyGrid(cells, 0.1, -1.0, 2.0), np.arange(8.0).reshape(2, 4))
    after = SeedMap.unpack(before.pack())
    assert after.occupied == 2
    assert np.array_equal(after.grid.cells, cells)
    assert (after.grid.resolution, after.grid.x, after.grid.y) == (0.1, -1.0, 2.0)
    assert np.array_equal(after.trajectory, before.trajectory)


def test_overlaps_survive_packing() -> None:
    data = pack_overlaps([Overlap(4, 1, MOTION, INFORMATION)])
    (found,) = unpack_overlaps(data, graph(5), graph(2))
    assert (found.node, found.near, found.motion) == (4, 1, MOTION)
    assert np.array_equal(found.information, INFORMATION)
    with pytest.raises(InvalidRequest, match="not nodes"):
        unpack_overlaps(data, graph(2), graph(5))


def test_comparisons_survive_packing() -> None:
    compared = [
        Comparison(2, [Candidate(2, 0, MOTION, INFORMATION)], [("b", Edge(1, 2, MOTION, INFORMATION, closure=True))]),
        Comparison(3, [], []),
    ]
    data = pack_comparisons(compared, ["a", "b"])
    first, second = unpack_comparisons(data, [2, 3], ["a", "b"], 4)
    assert [(each.new, each.old, each.motion) for each in first.candidates] == [(2, 0, MOTION)]
    assert [(name, tie.first, tie.second, tie.closure) for name, tie in first.ties] == [("b", 1, 2, True)]
    assert (second.number, second.candidates, second.ties) == (3, [], [])


@pytest.mark.parametrize(("nodes", "count"), [([3], 4), ([2, 3], 2)])
def test_comparisons_of_other_nodes_are_refused(nodes: list[int], count: int) -> None:
    data = pack_comparisons([Comparison(2, [Candidate(2, 0, MOTION, INFORMATION)], [])], ["a", "b"])
    with pytest.raises(InvalidRequest):
        unpack_comparisons(data, nodes, ["a", "b"], count)


@pytest.mark.parametrize("data", [b"", b"no archive", pack_state({"graph": {"poses": np.zeros((1, 2))}})])
def test_other_bytes_are_no_part(data: bytes) -> None:
    with pytest.raises(InvalidRequest):
        PartMap.unpack(data)


def test_state_is_named_in_errors() -> None:
    with pytest.raises(InvalidRequest, match="message of a mapping worker"):
        unpack_state(b"no archive")
