"""The large recording, the memory of the map service, and the report."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from rce.bench import large_recording as large
from rce.bench.large_recording import MEGABYTE, SMALL_SCANS, Result
from rce.errors import NotFound
from rce.mapping.evaluation.simulation import simulate
from rce.mapping.files.recordings import open_recording

RESULT = Result(
    size=400 * MEGABYTE,
    copy=2.0,
    upload=4.0,
    check=0.5,
    idle=100 * MEGABYTE,
    peak=130 * MEGABYTE,
    small=7.5,
    small_scans=60,
    meanwhile=True,
    large_scans=9,
)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Small recording, and one of about 20 MB."""
    return large.write(tmp_path_factory.mktemp("recordings"), 20 * MEGABYTE)


@pytest.mark.slow
def test_small_recording_has_the_first_scans_of_the_simulation(recordings: tuple[Path, Path]) -> None:
    scans = list(open_recording(recordings[0]))
    assert len(scans) == SMALL_SCANS
    first = next(iter(simulate()))
    assert scans[0].angle_min == pytest.approx(first.angle_min, abs=1e-6)
    assert scans[0].range_max == pytest.approx(first.range_max)
    seen = np.isfinite(first.ranges)
    assert scans[0].ranges[seen] == pytest.approx(first.ranges[seen], abs=1e-3)
    assert scans[0].odometry == pytest.approx(first.odometry, abs=1e-6)


@pytest.mark.slow
def test_large_recording_has_about_the_size_asked_for(recordings: tuple[Path, Path]) -> None:
    small, whole = recordings
    size = whole.stat().st_size
    assert abs(size - 20 * MEGABYTE) <= size / 2
    assert whole.read_bytes().startswith(small.read_bytes())


def test_resident_memory_is_that_of_the_process() -> None:
    status = Path("/proc/self/status").read_text().splitlines()
    expected = next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmRSS"))
    assert large.resident(os.getpid()) == pytest.approx(expected, rel=0.1)


async def test_peak_of_the_memory_is_watched(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes, seen = [5, 7, 9, 6], asyncio.Event()

    def resident(process: int) -> int:
        if len(sizes) == 1:
            seen.set()
        return sizes.pop(0) if len(sizes) > 1 else sizes[0]

    monkeypatch.setattr(large, "SAMPLE_INTERVAL", 0)
    monkeypatch.setattr(large, "resident", resident)
    async with large.watched(1) as peak:
        assert peak == [5]
        await asyncio.wait_for(seen.wait(), 20)
    assert peak == [9]


def test_missing_map_service_is_reported() -> None:
    with pytest.raises(NotFound, match="runs without its map service"):
        large.service_process()


def test_map_service_is_found_among_the_children() -> None:
    words = [sys.executable, "-c", "print(flush=True); input()", "-m", "rce.mapservice"]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()  # /proc does not show the command line of a program that is being started
            assert large.service_process() == process.pid
        finally:
            process.communicate(b"\n")


async def test_copy_is_removed_after_its_measurement(tmp_path: Path) -> None:
    file = tmp_path / "a.log"
    file.touch()
    assert await large._time_copy(file) > 0
    assert os.listdir(tmp_path) == ["a.log"]


@pytest.mark.parametrize(("meanwhile", "text"), [(True, "was still being"), (False, "was no longer being")])
def test_text_compares_the_upload_with_a_copy(meanwhile: bool, text: str) -> None:
    recording, memory, upload, check, other = large.as_text(replace(RESULT, meanwhile=meanwhile)).splitlines()
    assert recording.split() == ["recording", "400", "MB"]
    assert memory.endswith("100 MB idle, 30 MB more at most")
    assert upload.endswith("100 MB/s, 0.50 of a copy on the same disk (200 MB/s)")
    assert check.endswith("0.5 s until the job was accepted")
    assert other.endswith(f"60 scans in 7.5 s; the large one {text} mapped")


def test_data_has_all_results() -> None:
    assert Result(**json.loads(json.dumps(large.as_data(RESULT)))) == RESULT
