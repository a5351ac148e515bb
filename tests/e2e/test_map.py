"""`rce map` with a real platform."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import numpy as np
import pytest

from tests.support.e2e.mapping import SCANS, check_files, rce_map, relations, trajectory
from tests.support.e2e.real_platform import RealPlatform
from tests.support.paths import DATA


@pytest.fixture
async def temporary(tmp_path: Path) -> AsyncIterator[Path]:
    """Directory for temporary files. At the end it must be empty, and no process may use it."""
    directory = tmp_path / "temporary"
    directory.mkdir()
    yield directory
    assert not list(directory.iterdir())
    assert not RealPlatform(directory).processes()


@pytest.mark.skipif(not (DATA / "mit-csail.clf.gz").exists(), reason=f"needs mit-csail.clf.gz in {DATA}, or RCE_DATA")
async def test_maps_of_a_real_building(platform: RealPlatform, tmp_path: Path, temporary: Path) -> None:
    """Two robots map the log and the bag of the same run at the same time."""
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
    # The headings of the odometry differ in the last bit, which grows to a tenth of a millimetre.
    assert np.abs(difference).max() < 5e-4


async def test_simulation_with_a_platform_of_its_own(tmp_path: Path, temporary: Path) -> None:
    """The command starts and stops a platform."""
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
async def test_error_is_reported_in_one_line(
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
