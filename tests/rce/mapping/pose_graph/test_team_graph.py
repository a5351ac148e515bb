"""Common graph of joined robots."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.evaluation.trials import Relations, error_of, read_relations
from rce.mapping.files.recordings import open_recording
from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.pose_graph.graph import Edge, PoseGraph
from rce.mapping.pose_graph.mapper import GraphMapper
from rce.mapping.pose_graph.team_graph import Team
from rce.mapping.state import Reader, flatten
from tests.support.laser import sweep_at

PRECISE = 1e4 * np.eye(3)
ROOM = [Pose(1.2 + 1.1 * i, 2.4, 0.3) for i in range(4)]  # frame of the building
START = Pose(1.8, 3.4, 1.0)  # of the second robot, in the same room
SECOND = [START, START @ Pose(0.8, 0.0, 0.0)]


def graph_of(places: list[Pose]) -> PoseGraph:
    """Return the graph of a robot that was at these places of the apartment; the first is its origin."""
    graph = PoseGraph()
    for pose in places:
        number = graph.add_node(places[0].to(pose))
        graph.nodes[number].sweeps.append(sweep_at(pose))
    for i, j in pairwise(graph.nodes):
        graph.add_edges([Edge(i, j, graph.nodes[i].pose.to(graph.nodes[j].pose), PRECISE)])
    return graph


@pytest.fixture
def graphs() -> dict[str, PoseGraph]:
    return {"one": graph_of(ROOM), "two": graph_of(SECOND)}


@pytest.fixture
def joined(graphs: dict[str, PoseGraph]) -> Team:
    """Both robots, with a pose of the second that is off by some centimetres."""
    one, two = (Team({name: graph}, 0.05) for name, graph in graphs.items())
    return Team.merged(one, two, ROOM[0].to(START) @ Pose(0.12, -0.08, 0.02))


def join(team: Team) -> None:
    """Add the closure by which the teams were joined, which is exact."""
    ends = team.node_of("one", 1), team.node_of("two", 0)
    team.add_joining_edges([Edge(*ends, ROOM[1].to(START), PRECISE, closure=True)])


def test_single_robot_shares_its_graph(graphs: dict[str, PoseGraph]) -> None:
    team = Team({"one": graphs["one"]}, 0.05)
    assert team.graph is graphs["one"]
    assert team.names == ["one"]
    assert [team.node_of("one", own) for own in graphs["one"].nodes] == [0, 1, 2, 3]
    team.compare("one", 3)  # its mapper closes its loops
    assert len(team.graph.edges) == 3


def test_merged_graph_has_the_nodes_and_edges_of_both_in_the_frame_of_the_first(joined: Team) -> None:
    assert joined.names == ["one", "two"]
    assert (len(joined.graph.nodes), len(joined.graph.edges)) == (6, 4)
    assert joined.pose("one", 0) == pytest.approx(ORIGIN, abs=1e-9)
    assert joined.pose("two", 0) == pytest.approx(ROOM[0].to(START) @ Pose(0.12, -0.08, 0.02))


def test_closure_moves_the_second_robot(joined: Team) -> None:
    join(joined)
    assert joined.pose("two", 0) == pytest.approx(ROOM[0].to(START), abs=1e-3)
    assert joined.pose("one", 0) == pytest.approx(ORIGIN, abs=1e-9)


def test_new_nodes_of_a_robot_are_added(joined: Team, graphs: dict[str, PoseGraph]) -> None:
    two, step = graphs["two"], Pose(0.5, 0.0, 0.0)
    two.add_edges([Edge(1, two.add_node(two.nodes[1].pose @ step), step, PRECISE)])
    joined.update("two")
    joined.update("two")  # nothing is new
    assert (len(joined.graph.nodes), len(joined.graph.edges)) == (7, 5)
    assert joined.pose("two", 2) == pytest.approx(joined.pose("two", 1) @ step)


def test_edges_that_a_robot_has_dropped_are_dropped(joined: Team, graphs: dict[str, PoseGraph]) -> None:
    join(joined)
    wrong = Edge(0, 3, ORIGIN, PRECISE, closure=True)
    graphs["one"].add_edges([wrong])
    joined.update("one")
    assert len(joined.graph.edges) == 6
    graphs["one"].remove_edges([wrong])
    joined.update("one")
    assert [(edge.first, edge.second) for edge in joined.graph.edges if edge.closure] == [(1, 4)]
    assert len(joined.graph.edges) == 5


def test_places_of_both_robots_are_tied_where_they_match(joined: Team) -> None:
    """Closures are searched across a long way only: here the edge that joins the robots is in doubt."""
    ends = joined.node_of("one", 1), joined.node_of("two", 0)
    doubtful = np.diag([1.0, 1.0, 100.0])
    joined.add_joining_edges([Edge(*ends, ROOM[1].to(START), doubtful, closure=True)])
    before = len(joined.graph.edges)
    joined.settle()
    ties, places = joined.graph.edges[before:], [*ROOM, *SECOND]
    assert ties
    for tie in ties:
        assert tie.motion == pytest.approx(places[tie.first].to(places[tie.second]), abs=0.05)


def test_map_shows_what_both_have_seen_and_follows_corrections(joined: Team, graphs: dict[str, PoseGraph]) -> None:
    before = joined.grid()
    join(joined)
    after = joined.grid()
    alone = Team({"one": graphs["one"]}, 0.05).grid()
    assert (after.cells >= 65).sum() < (before.cells >= 65).sum(), "walls are no longer double"
    assert (after.cells >= 0).sum() >= (alone.cells >= 0).sum()
    np.testing.assert_array_equal(joined.grid().cells, after.cells)


@pytest.mark.slow
def test_all_places_are_compared_after_the_first_overlap(data: Path) -> None:
    """Two robots crossed the same hall in opposite directions, and their odometry has drifted since."""
    scans = list(open_recording(data / "mit-csail.clf.gz"))
    parts = {"one": scans[380:640], "two": scans[1480:1600]}
    mappers = {name: GraphMapper() for name in parts}
    for name, mapper in mappers.items():
        for scan in parts[name]:
            mapper.add(scan)
    one, two = (Team({name: mapper.graph}, 0.05) for name, mapper in mappers.items())
    seen = Pose(-0.61, 0.29, 3.06)  # pose of node 7 of the second robot in the frame of node 6 of the first
    together = Team.merged(one, two, one.pose("one", 6) @ seen @ two.pose("two", 7).inverse())
    ends = together.node_of("one", 6), together.node_of("two", 7)
    together.add_joining_edges([Edge(*ends, seen, np.diag([500.0, 500.0, 5000.0]), closure=True)])
    together.settle()
    ways = [
        mapper.trajectory_by(np.array([together.pose(name, node) for node in mapper.graph.nodes]))
        for name, mapper in mappers.items()
    ]
    relations = read_relations(data / "mit-csail.relations", np.concatenate(ways)[:, 0])
    across = (relations.ends[:, 0] < len(ways[0])) & (relations.ends[:, 1] >= len(ways[0]))
    between = Relations(relations.ends[across], relations.motions[across])
    error = error_of(np.concatenate(ways), between)
    assert error.relations > 20
    assert error.translation < 0.06
    assert error.worst < 0.2


def test_comparisons_of_a_snapshot_are_those_of_the_team(joined: Team, graphs: dict[str, PoseGraph]) -> None:
    """A team that is restored from its snapshot finds the same; adding it does what `compare` does."""
    join(joined)
    restored = Team.of_snapshot(graphs, Reader(dict(flatten(joined.snapshot()))), 0.05)
    nodes = joined.take_waiting()
    assert sorted(nodes) == list(range(6))
    assert joined.take_waiting() == []
    before = len(joined.graph.edges)
    found = [restored.comparison(node) for node in nodes]
    assert any(comparison.ties for comparison in found)
    assert len(joined.graph.edges) == before, "a comparison does not change the team"
    joined.add_comparisons(found)
    ties = sum(len(comparison.ties) for comparison in found)
    assert len(joined.graph.edges) == before + ties
    assert joined.pose("two", 0) == pytest.approx(tuple(ROOM[0].to(START)), abs=0.03)


@pytest.mark.parametrize("owners", [[[0, 0]], [[2, 0]] * 6, [[0, 1]] * 6])
def test_snapshot_of_other_robots_is_refused(
    joined: Team, graphs: dict[str, PoseGraph], owners: list[list[int]]
) -> None:
    state = dict(flatten(joined.snapshot())) | {"owners": np.array(owners, np.int64)}
    with pytest.raises(InvalidRequest):
        Team.of_snapshot(graphs, Reader(state), 0.05)
