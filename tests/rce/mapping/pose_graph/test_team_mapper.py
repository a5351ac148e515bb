"""Tests of the mapper of a team of robots with unknown relative starts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path

import numpy as np
import pytest

from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.evaluation.trials import Relations, error_of, read_relations
from rce.mapping.files.recordings import open_recording
from rce.mapping.geometry import Pose
from rce.mapping.pose_graph.graph import Edge, PoseGraph, Sweep
from rce.mapping.pose_graph.mapper import GraphMapper
from rce.mapping.pose_graph.overlaps import WholeMap
from rce.mapping.pose_graph.team_graph import Team
from rce.mapping.pose_graph.team_mapper import TeamMapper
from rce.mapping.scans import Scan


def in_turns(parts: dict[str, Sequence[Scan]]) -> Iterator[tuple[str, Scan]]:
    for scans in zip_longest(*parts.values()):
        yield from ((name, scan) for name, scan in zip(parts, scans, strict=True) if scan is not None)


def test_single_robot_is_its_own_team(simulation: Simulation) -> None:
    team = TeamMapper(["one", "two"])
    for scan in simulation.records[:20]:
        estimate = team.add("one", scan)
    assert (team.team("one"), team.team("two")) == (["one"], ["two"])
    last = team.trajectory("one")[-1]
    assert tuple(last[1:]) == pytest.approx(estimate.pose)
    assert team.grid("one").cells.size > team.grid("two").cells.size


def test_place_is_found_anywhere_in_a_whole_map() -> None:
    random = np.random.default_rng(0)
    corners = random.uniform(0, 30, (60, 2))
    along = np.linspace(0, 2, 40)[:, None]
    walls = np.concatenate([corner + along * ([1, 0] if i % 2 else [0, 1]) for i, corner in enumerate(corners)])
    graph = PoseGraph()
    graph.add_node(Pose(0, 0, 0))
    graph.nodes[0].sweeps.append(Sweep(np.zeros((1, 2)), walls.astype(np.float32)))
    at = Pose(14.0, 17.0, 2.5)
    seen = at.inverse().transform(walls)
    found = WholeMap(graph).find(seen[np.hypot(*seen.T) < 12][::3])
    assert found is not None
    off = at.to(found.motion)
    assert np.hypot(off.x, off.y) < 0.05
    assert abs(off.theta) < 0.01
    assert WholeMap(graph).find(random.uniform(-10, 10, (300, 2))) is None


def test_two_robots_are_joined_while_they_drive(data: Path) -> None:
    """The robots map overlapping parts of one recording, each in a frame of its own."""
    scans = list(open_recording(data / "mit-csail.clf.gz"))
    parts = {"one": scans[0:330], "two": scans[150:480]}
    team = TeamMapper(parts)
    joined = None
    for count, (name, scan) in enumerate(in_turns(parts)):
        team.add(name, scan)
        if joined is None and team.team("one") == ["one", "two"]:
            joined = count
    assert joined is not None, "the robots were not joined"
    shared = {row[0]: row[1:] for row in team.trajectory("one")}
    off = [row[1:] - shared[row[0]] for row in team.trajectory("two") if row[0] in shared]
    assert len(off) == 180
    assert np.hypot(*np.array(off)[:, :2].T).mean() < 0.05, "shared scans have the same poses"
    assert team.grid("one").cells.shape == team.grid("two").cells.shape


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


def test_team_without_scans_has_an_empty_map() -> None:
    team = TeamMapper(["one", "two"])
    assert len(team.trajectory("one")) == 0
    assert (team.grid("one").cells == -1).all()
