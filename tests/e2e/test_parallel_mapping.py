"""Mapping jobs of several workers in a real platform: the command line and the map service."""

from __future__ import annotations

import asyncio
import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from rce.mapping.evaluation.simulation import simulate
from rce.mapping.evaluation.trials import error_of, read_relations
from rce.mapping.mapper import MapperSettings
from rce.mapping.parallel.run import Method, run
from tests.support.e2e.mapping import rce
from tests.support.e2e.real_platform import RealPlatform, until
from tests.support.e2e.recordings import LOG
from tests.support.paths import DATA

PIECES = {"first.log": slice(0, 450), "second.log": slice(300, 750)}
WORKER = r"rce_mapping/worker"
TIMEOUT = 240.0  # seconds

needs_log = pytest.mark.skipif(not LOG.exists(), reason=f"needs {LOG.name} in {DATA}, or RCE_DATA")


def joint_trajectory(directory: Path) -> NDArray[np.float64]:
    """Return (n, 4) stamp, x, y, theta of the scans of both recordings, in order of time."""
    rows = np.concatenate([np.loadtxt(directory / f"trajectory_{number}.txt") for number in (1, 2)])
    return rows[np.argsort(rows[:, 0], kind="stable")]


@pytest.fixture
def recordings(tmp_path: Path) -> list[Path]:
    """Two recordings of one building: overlapping pieces of a log."""
    with gzip.open(LOG) as log:
        lines = [line for line in log if line.startswith(b"FLASER")][::2]
    for name, part in PIECES.items():
        (tmp_path / name).write_bytes(b"".join(lines[part]))
    return [tmp_path / name for name in PIECES]


async def test_worker_that_dies_costs_its_unit_only(fragile: RealPlatform) -> None:
    """A worker is killed while it maps; another one maps its part, and nothing is left on the fragile."""
    scans = simulate().records
    method = Method(2, "graph", MapperSettings())
    mapping = asyncio.Event()
    async with fragile.robot("parallel_job") as robot:
        job = asyncio.create_task(run(robot, "parallel_job", [scans, scans[50:]], method, lambda _: mapping.set()))
        await asyncio.wait_for(mapping.wait(), 60)
        victim = next(pid for pid, words in fragile.processes().items() if WORKER in words)
        fragile.kill(victim)
        done = await asyncio.wait_for(job, TIMEOUT)
    assert done.lost == 1
    assert sorted(len(each) for joint in done.maps for each in joint.trajectories.values()) == [
        len(scans) - 50,
        len(scans),
    ]
    await until(lambda: not any(WORKER in words for words in fragile.processes().values()), what="no worker is left")


@needs_log
async def test_recordings_become_one_map_by_the_command_line_and_by_the_service(
    platform: RealPlatform, recordings: list[Path], tmp_path: Path
) -> None:
    where = ("--url", platform.url, "--user", "testUser", "--password", "testUser")
    status, output, errors = await rce("map", "--parallel", "2", *recordings, "--out", tmp_path / "own", *where)
    assert status == 0, errors
    assert f"robot 2 (second.log): 450 scans mapped, on the map in {tmp_path / 'own'}" in output
    words = ("map", "submit", "--parallel", "2", *recordings, "--wait", "--out", tmp_path / "served", *where)
    status, output, errors = await rce(*words)
    assert status == 0, errors
    assert "900 scans mapped" in output
    for place in ("own", "served"):
        names = {path.name for path in (tmp_path / place).iterdir()}
        assert {"map.pgm", "map.yaml", "map.png", "trajectory_1.txt", "trajectory_2.txt"} <= names
        assert not any("map_2" in name for name in names), "the recordings overlap"
    times = json.loads((tmp_path / "served" / "times.json").read_text())
    assert {"opening", "mapping", "writing"} <= set(times)
    same = [(tmp_path / place / "trajectory_2.txt").read_text() for place in ("own", "served")]
    assert same[0] == same[1], "the result does not depend on who asks for it"
    rows = joint_trajectory(tmp_path / "own")
    assert error_of(rows, read_relations(DATA / "mit-csail.relations", rows[:, 0])).translation < 0.05
