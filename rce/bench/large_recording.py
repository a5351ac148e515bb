"""Benchmark of the map service with a recording of several GB.

It measures the memory of the service, the speed of the upload, and the job of another user meanwhile.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import secrets
import shutil
import subprocess
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct

from rce.api.map_jobs import FINAL_STATES, Job
from rce.cli.arguments import DEV_USER
from rce.cli.platform import own_platform
from rce.client.map_service import MapServiceClient
from rce.errors import InternalError, NotFound
from rce.mapping.evaluation.simulation import simulate
from rce.process import programs

MEGABYTE = 1_000_000
OTHER_USER = "benchUser"
SMALL_SCANS = 60  # scans of the small recording
SAMPLE_INTERVAL = 0.05  # seconds between samples of the memory
PROGRAM = b"rce.mapservice\0"  # in the command line of the map service


class Result(Struct, frozen=True):
    """Results.

    Attributes:
        size: Bytes of the large recording.
        copy: Seconds of a copy on the same disk, the mean of one before and one after the upload.
        upload: Seconds of the upload.
        check: Seconds until the job was accepted.
        idle: Bytes of memory before the upload.
        peak: Most bytes of memory meanwhile.
        small: Seconds of the job of the other user.
        small_scans: Scans of that job.
        meanwhile: Whether the large recording was still being mapped when that job ended.
        large_scans: Scans of the large recording mapped by then.
    """

    size: int
    copy: float
    upload: float
    check: float
    idle: int
    peak: int
    small: float
    small_scans: int
    meanwhile: bool
    large_scans: int


def line(number: int, scan: Any) -> str:
    """Return a scan as a ROBOTLASER1 line of CARMEN, which supports any field of view."""
    ranges = np.where(np.isfinite(scan.ranges), scan.ranges, scan.range_max)
    x, y, theta = scan.odometry
    view = scan.angle_increment * (len(ranges) - 1)
    head = f"0 {scan.angle_min:.9f} {view:.9f} {scan.angle_increment:.9f} {scan.range_max:.2f} 0.01 0 {len(ranges)}"
    pose = f"{x:.6f} {y:.6f} {theta:.6f}"
    text = " ".join(f"{value:.3f}" for value in ranges)
    return f"ROBOTLASER1 {head} {text} 0 {pose} {pose} 0 0 0.3 0.3 1000 {scan.stamp:.6f} robot {number}\n"


def write(directory: Path, size: int) -> tuple[Path, Path]:
    """Write a small recording, and one of `size` bytes that repeats a simulated one; return their paths."""
    lines = [line(number, scan).encode() for number, scan in enumerate(simulate())]
    small, large = directory / "small.log", directory / "large.log"
    small.write_bytes(b"".join(lines[:SMALL_SCANS]))
    block = b"".join(lines)
    with large.open("wb") as file:
        for _ in range(max(1, round(size / len(block)))):
            file.write(block)
    return small, large


async def measure(directory: Path, size: int, engine: str) -> Result:
    """Run the benchmark.

    Args:
        directory: Directory on the disk to measure; files written there are removed.
        size: Bytes of the large recording.
        engine: Engine of the platform.

    Raises:
        InternalError: A job ended in an unexpected state.
        NotFound: The platform runs without its map service.
    """
    with contextlib.ExitStack() as stack:
        place = directory / f"rce-bench-{os.getpid()}"
        place.mkdir(parents=True)
        stack.callback(shutil.rmtree, place, True)
        small, large = await asyncio.to_thread(write, place, size)
        async with own_platform(place / "platform", engine) as entry:
            password = await asyncio.to_thread(add_user, place / "platform" / "master")
            ours = MapServiceClient(entry.url, user=DEV_USER, password=DEV_USER)
            other = MapServiceClient(entry.url, user=OTHER_USER, password=password)
            return await _measure(large, small, ours, other, service_process())


async def _measure(large: Path, small: Path, ours: MapServiceClient, other: MapServiceClient, process: int) -> Result:
    for service in (ours, other):
        await asyncio.to_thread(service.jobs)  # the first request loads code, whose memory is not that of the recording
    idle = resident(process)
    before = await _time_copy(large)
    async with watched(process) as peak:
        started = time.perf_counter()
        upload = await asyncio.to_thread(ours.upload, large)
        sent = time.perf_counter() - started
        after = await _time_copy(large)
        started = time.perf_counter()
        job = await asyncio.to_thread(ours.submit, [upload.id])
        checked = time.perf_counter() - started
        started = time.perf_counter()
        done = await asyncio.to_thread(_whole_job, other, small)
        needed = time.perf_counter() - started
        seen = await asyncio.to_thread(_when_mapping, ours, job.id)
        await asyncio.to_thread(ours.cancel, job.id)
        last = await asyncio.to_thread(_until_over, ours, job.id)
    if done.state != "done" or last.state != "cancelled":
        raise InternalError(
            f"unexpected states of jobs: the small one is {done.state}, the cancelled large one {last.state}"
        )
    await asyncio.to_thread(ours.remove, job.id)
    meanwhile = seen.state == "running" and seen.stage == "mapping"
    return Result(
        upload.length, (before + after) / 2, sent, checked, idle, peak[0], needed, done.scans, meanwhile, seen.scans
    )


async def _time_copy(file: Path) -> float:
    """Return the seconds that `cp` takes on the same disk, without the cost of earlier or later writes."""
    copy = file.with_suffix(".copy")
    await asyncio.to_thread(os.sync)
    started = time.perf_counter()
    await asyncio.to_thread(subprocess.run, ["cp", str(file), str(copy)], check=True)
    elapsed = time.perf_counter() - started
    copy.unlink()
    await asyncio.to_thread(os.sync)
    return elapsed


def _when_mapping(service: MapServiceClient, job: str) -> Job:
    """Return the job as soon as scans of it are mapped, or when it is over."""
    return next(seen for seen in service.watch(job) if seen.scans > 0 or seen.state in FINAL_STATES)


def _until_over(service: MapServiceClient, job: str) -> Job:
    """Wait until a job is over."""
    *_, last = service.watch(job)
    return last


def _whole_job(service: MapServiceClient, recording: Path) -> Job:
    """Upload and map a recording."""
    return _until_over(service, service.submit([service.upload(recording).id]).id)


def add_user(directory: Path) -> str:
    """Add OTHER_USER to the database of the Master; return the password."""
    words = [*programs.command("user"), "--data-dir", str(directory), "add", OTHER_USER]
    password = secrets.token_hex(16)
    subprocess.run(words, input=password.encode(), check=True, capture_output=True)
    return password


def service_process() -> int:
    """Return the id of the map service that this process has started.

    Raises:
        NotFound: There is none.
    """
    for place in Path("/proc").iterdir():
        with contextlib.suppress(OSError):
            if place.name.isdigit() and PROGRAM in (place / "cmdline").read_bytes():
                parent = (place / "stat").read_text().rpartition(")")[2].split()[1]
                if int(parent) == os.getpid():
                    return int(place.name)
    raise NotFound("the platform runs without its map service: pip install '.[server]' in a checkout of RCE")


def resident(process: int) -> int:
    """Return the resident memory of a process in bytes."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


@contextlib.asynccontextmanager
async def watched(process: int) -> AsyncIterator[list[int]]:
    """Sample the memory of a process meanwhile; yield a list whose only item is the peak in bytes."""
    peak = [resident(process)]

    async def sample() -> None:
        while True:
            peak[0] = max(peak[0], resident(process))
            await asyncio.sleep(SAMPLE_INTERVAL)

    watcher = asyncio.create_task(sample())
    try:
        yield peak
    finally:
        watcher.cancel()


def as_data(result: Result) -> dict[str, Any]:
    """Return the results for JSON."""
    return {field: getattr(result, field) for field in result.__struct_fields__}


def as_text(result: Result) -> str:
    """Return the results as text."""
    size, grown = result.size / MEGABYTE, (result.peak - result.idle) / MEGABYTE
    copy, upload = size / result.copy, size / result.upload
    still = "was still being mapped" if result.meanwhile else "was no longer being mapped"
    return "\n".join(
        [
            f"recording         {size:.0f} MB",
            f"memory            {result.idle / MEGABYTE:.0f} MB idle, {grown:.0f} MB more at most",
            f"upload            {upload:.0f} MB/s, {upload / copy:.2f} of a copy on the same disk ({copy:.0f} MB/s)",
            f"check             {result.check:.1f} s until the job was accepted",
            f"other user's job  {result.small_scans} scans in {result.small:.1f} s; the large one {still}",
        ]
    )
