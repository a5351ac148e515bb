"""`rce map` as a process, and checks of its results."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.support.e2e.real_platform import RCE
from tests.support.paths import DATA

TIMEOUT = 300.0  # seconds


class CommandResult(NamedTuple):
    status: int
    output: str
    errors: str


async def rce(*words: str | Path, environment: Mapping[str, str] | None = None) -> CommandResult:
    """Run `rce` with these words, and with these environment variables in addition."""
    process = await asyncio.create_subprocess_exec(
        *(RCE, *map(str, words)),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env={**os.environ, **(environment or {})},
    )
    try:
        output, errors = await asyncio.wait_for(process.communicate(), TIMEOUT)
    except TimeoutError:
        process.kill()
        raise
    return CommandResult(process.returncode or 0, output.decode(), errors.decode())


async def rce_map(*words: str | Path, temporary: Path, command: str = "map") -> CommandResult:
    """Run the command with `temporary` as its directory for temporary files."""
    return await rce(command, *words, environment={"TMPDIR": str(temporary)})


FILES = ["map.pgm", "map.png", "map.yaml", "trajectory.txt"]
SCANS = 1988  # of MIT CSAIL


def trajectory(directory: Path) -> NDArray[np.float64]:
    return np.loadtxt(directory / "trajectory.txt")


def check_files(directory: Path, scans: int) -> None:
    """Check the files of map_server, the picture, and that there is a pose for each scan."""
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


async def relations(path: Path) -> dict[str, Any]:
    """Return the errors of a trajectory by the ground truth of MIT CSAIL: means and standard deviations."""
    tool = [sys.executable, DATA / "tools" / "slam_metric.py", path, DATA / "mit-csail.relations", "--json"]
    process = await asyncio.create_subprocess_exec(*map(str, tool), stdout=asyncio.subprocess.PIPE)
    found: dict[str, Any] = json.loads((await process.communicate())[0])
    return found
