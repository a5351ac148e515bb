"""Several robots whose starts nobody knows, and one map."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path

import numpy as np
import pytest

from rce.mapping.geometry import Pose
from rce.mapping.graph import Edge, PoseGraph, Sweep
from rce.mapping.graph_mapper import GraphMapper
from rce.mapping.joined import Team
from rce.mapping.overlaps import WholeMap
from rce.mapping.recordings import open_recording
from rce.mapping.scans import Scan
from rce.mapping.simulation import Simulation
from rce.mapping.team import TeamMapper
from rce.mapping.trials import Relations, error_of, read_relations


def in_turns(parts: dict[str, Sequence[Scan]]) -> Iterator[tuple[str, Scan]]:
    for scans in zip_longest(*parts.values()):
        yield from ((name, scan) for name, scan in zip(parts, scans, strict=True) if scan is not None)


def test_a_lone_robot_is_a_team_of_its_own(simulation: Simulation) -> None:
    team = TeamMapper(["one", "two"])
    for scan in simulation.records[:20]:
        estimate = team.add("one", scan)
    assert (team.team("one"), team.team("two")) == (["one"], ["two"])
    last = team.trajectory("one")[-1]
    assert tuple(last[1:]) == pytest.approx(estimate.pose)
    assert team.grid("one").cells.size > team.grid("two").cells.size


def test_a_place_is_found_in_a_whole_map_wherever_it_is() -> None:
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


def test_two_robots_of_one_recording_are_joined_while_they_drive(data: Path) -> None:
    """Overlapping parts of a run through a building, each in a frame of its own that begins where it begins."""
    scans = list(open_recording(data / "mit-csail.clf.gz"))
    parts = {"one": scans[0:330], "two": scans[150:480]}
    team = TeamMapper(parts)
    joined = None
    for count, (name, scan) in enumerate(in_turns(parts)):
        team.add(name, scan)
        if joined is None and team.team("one") == ["one", "two"]:
            joined = count
    assert joined is not None, "they never found each other"
    shared = {row[0]: row[1:] for row in team.trajectory("one")}
    off = [row[1:] - shared[row[0]] for row in team.trajectory("two") if row[0] in shared]
    assert len(off) == 180
    assert np.hypot(*np.array(off)[:, :2].T).mean() < 0.05, "both were at the same places at the same stamps"
    assert team.grid("one").cells.shape == team.grid("two").cells.shape


def test_from_one_overlap_on_all_that_two_robots_saw_is_compared(data: Path) -> None:
    """Two robots came through the same hall, the other way round, and a robot's own odometry has drifted meanwhile."""
    scans = list(open_recording(data / "mit-csail.clf.gz"))
    parts = {"one": scans[380:640], "two": scans[1480:1600]}
    mappers = {name: GraphMapper() for name in parts}
    for name, mapper in mappers.items():
        for scan in parts[name]:
            mapper.add(scan)
    one, two = (Team({name: mapper.graph}, 0.05) for name, mapper in mappers.items())
    seen = Pose(-0.61, 0.29, 3.06)  # the second's place 7 from the first's place 6
    together = Team.of(one, two, one.pose("one", 6) @ seen @ two.pose("two", 7).inverse())
    ends = together.number("one", 6), together.number("two", 7)
    together.believe([Edge(*ends, seen, np.diag([500.0, 500.0, 5000.0]), closure=True)])
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


def test_a_team_of_which_nobody_has_moved_shows_an_empty_map() -> None:
    team = TeamMapper(["one", "two"])
    assert len(team.trajectory("one")) == 0
    assert (team.grid("one").cells == -1).all()
