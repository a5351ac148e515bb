"""`rce map`: recordings through the whole chain, from the command line to the files."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from real_platform import RCE, RealPlatform

DATA = Path(os.environ.get("RCE_DATA", Path(__file__).parents[3] / "shared" / "data"))
FILES = ["map.pgm", "map.png", "map.yaml", "trajectory.txt"]
SCANS = 1988
LONGEST = 180.0  # seconds


class Done(NamedTuple):
    status: int
    output: str
    errors: str


async def rce_map(*words: str | Path, temporary: Path) -> Done:
    """Run the command; `temporary` is where what it starts for itself goes."""
    process = await asyncio.create_subprocess_exec(
        *(RCE, "map", *map(str, words)),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(temporary)},
    )
    try:
        output, errors = await asyncio.wait_for(process.communicate(), LONGEST)
    except TimeoutError:
        process.kill()
        raise
    return Done(process.returncode or 0, output.decode(), errors.decode())


@pytest.fixture
async def temporary(tmp_path: Path) -> AsyncIterator[Path]:
    """A directory for temporary files, in which nothing may be left; nor any process that knows it."""
    directory = tmp_path / "temporary"
    directory.mkdir()
    yield directory
    assert not list(directory.iterdir())
    assert not RealPlatform(directory).processes()


def trajectory(directory: Path) -> NDArray[np.float64]:
    return np.loadtxt(directory / "trajectory.txt")


def check_files(directory: Path, scans: int) -> None:
    """The files of map_server, a picture of the same size, and a pose for every scan."""
    assert sorted(path.name for path in directory.iterdir()) == FILES
    grid = cv2.imread(str(directory / "map.pgm"), cv2.IMREAD_UNCHANGED)
    picture = cv2.imread(str(directory / "map.png"), cv2.IMREAD_UNCHANGED)
    assert grid is not None
    assert picture is not None
    assert set(np.unique(grid)) <= {0, 205, 254}
    assert (grid == 0).sum() > 100
    assert (grid == 254).sum() > 1000
    settings = dict(line.split(": ", 1) for line in (directory / "map.yaml").read_text().splitlines())
    assert settings["image"] == "map.pgm"
    assert float(settings["resolution"]) > 0
    assert len(json.loads(settings["origin"])) == 3
    poses = trajectory(directory)
    assert poses.shape == (scans, 4)
    assert np.isfinite(poses).all()
    assert (np.diff(poses[:, 0]) > 0).all()


@pytest.mark.skipif(not (DATA / "mit-csail.clf.gz").exists(), reason=f"needs mit-csail.clf.gz in {DATA}, or RCE_DATA")
async def test_a_real_building(platform: RealPlatform, tmp_path: Path, temporary: Path) -> None:
    """The log and the bag of one run, at the same time, by two robots."""
    sources = {"log": DATA / "mit-csail.clf.gz", "bag": DATA / "bags" / "mit-csail"}
    runs = [
        rce_map(source, "--url", platform.url, "--out", tmp_path / name, temporary=temporary)
        for name, source in sources.items()
    ]
    for done in await asyncio.gather(*runs):
        assert done.status == 0, done.errors
        assert f"{SCANS} scans mapped" in done.output
    for name in sources:
        check_files(tmp_path / name, SCANS)
    error = await relations(tmp_path / "log" / "trajectory.txt")
    assert error["used"] == error["relations"]
    assert error["trans_abs"][0] <= 0.15
    assert error["rot_abs_deg"][0] <= 3
    difference = trajectory(tmp_path / "log") - trajectory(tmp_path / "bag")
    assert np.abs(difference).max() < 1e-6


async def relations(path: Path) -> dict[str, Any]:
    """The metric of the recording's ground truth: means and standard deviations."""
    tool = [sys.executable, DATA / "tools" / "slam_metric.py", path, DATA / "mit-csail.relations", "--json"]
    process = await asyncio.create_subprocess_exec(*map(str, tool), stdout=asyncio.subprocess.PIPE)
    found: dict[str, Any] = json.loads((await process.communicate())[0])
    return found


async def test_a_simulated_robot_with_a_platform_of_its_own(tmp_path: Path, temporary: Path) -> None:
    """Nothing is running before, and nothing after."""
    done = await rce_map("--simulate", "--out", tmp_path / "map", temporary=temporary)
    assert done.status == 0, done.errors
    check_files(tmp_path / "map", int(done.output.split()[0]))


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ((), "give recordings, or --simulate"),
        (("nothing.clf",), "nothing.clf"),
        ((DATA / "bags" / "version-1.2.bag",), "1.2"),
        (("log", "--url", "http://127.0.0.1:1/"), "cannot reach http://127.0.0.1:1/"),
        (("log", "--url", "platform", "--password", "wrong"), "password"),
        (("log", "--url", "platform", "--user", "nobody", "--password", "x"), "password"),
        (("log", "--url", "no url"), "http://"),
    ],
)
async def test_what_cannot_be_done_is_said_in_a_line(
    platform: RealPlatform, tmp_path: Path, temporary: Path, words: tuple[str | Path, ...], reason: str
) -> None:
    if any(isinstance(word, Path) and not word.exists() for word in words):
        pytest.skip(f"needs {words[0]}, or RCE_DATA")
    log = tmp_path / "short.log"
    log.write_text("FLASER 3 1.0 1.0 1.0 0 0 0 0 0 0 5.0 host 5.0\n")
    known: dict[str, str | Path] = {"platform": platform.url, "log": log}
    given = [known.get(str(word), word) for word in words]
    done = await rce_map(*given, "--out", tmp_path / "map", temporary=temporary)
    assert done.status in (1, 2)
    assert reason in done.errors
    assert len(done.errors.splitlines()) == 1, done.errors
    assert not (tmp_path / "map").exists()
