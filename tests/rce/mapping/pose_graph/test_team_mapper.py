"""Tests of the mapper of a team of robots with unknown relative starts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path

import numpy as np
import pytest

from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.files.recordings import open_recording
from rce.mapping.pose_graph.team_mapper import TeamMapper
from rce.mapping.scans import Scan


def in_turns(parts: Mapping[str, Sequence[Scan]]) -> Iterator[tuple[str, Scan]]:
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


@pytest.mark.slow
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


def test_team_without_scans_has_an_empty_map() -> None:
    team = TeamMapper(["one", "two"])
    assert len(team.trajectory("one")) == 0
    assert (team.grid("one").cells == -1).all()
