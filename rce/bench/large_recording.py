"""A recording of several GB through the map service: its memory, the speed of the upload, and another user's job."""

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

from rce import programs
from rce.client.map_service import MapService
from rce.commands.platform import DEV_USER, own_platform
from rce.errors import InternalError, NotFound
from rce.map_jobs import OVER, Job
from rce.mapping.simulation import simulate

MEGABYTE = 1_000_000
OTHER = "benchUser"
SMALL_SCANS = 60
LOOK_EVERY = 0.05  # seconds between looks at the memory
PROGRAM = b"rce.mapservice\0"


class Result(Struct, frozen=True):
    """Sizes in bytes, times in seconds. `copy`: the mean of one before the upload and one after it. `meanwhile`: the
    large job was still being mapped when the small one ended."""

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
    """A scan as CARMEN's ROBOTLASER1, which knows every field of view."""
    ranges = np.where(np.isfinite(scan.ranges), scan.ranges, scan.range_max)
    x, y, theta = scan.odometry
    view = scan.angle_increment * (len(ranges) - 1)
    head = f"0 {scan.angle_min:.9f} {view:.9f} {scan.angle_increment:.9f} {scan.range_max:.2f} 0.01 0 {len(ranges)}"
    pose = f"{x:.6f} {y:.6f} {theta:.6f}"
    text = " ".join(f"{value:.3f}" for value in ranges)
    return f"ROBOTLASER1 {head} {text} 0 {pose} {pose} 0 0 0.3 0.3 1000 {scan.stamp:.6f} robot {number}\n"


def write(directory: Path, size: int) -> tuple[Path, Path]:
    """A small recording, and one of `size` bytes by repetition of a simulated one."""
    lines = [line(number, scan).encode() for number, scan in enumerate(simulate())]
    small, large = directory / "small.log", directory / "large.log"
    small.write_bytes(b"".join(lines[:SMALL_SCANS]))
    block = b"".join(lines)
    with large.open("wb") as file:
        for _ in range(max(1, round(size / len(block)))):
            file.write(block)
    return small, large


async def measure(directory: Path, size: int, engine: str) -> Result:
    """`directory` is on the disk in question; what is written there is removed again."""
    with contextlib.ExitStack() as stack:
        place = directory / f"rce-bench-{os.getpid()}"
        place.mkdir(parents=True)
        stack.callback(shutil.rmtree, place, True)
        small, large = await asyncio.to_thread(write, place, size)
        async with own_platform(place / "platform", engine) as entry:
            password = await asyncio.to_thread(add_user, place / "platform" / "master")
            ours = MapService(entry.url, user=DEV_USER, password=DEV_USER)
            other = MapService(entry.url, user=OTHER, password=password)
            return await _measure(large, small, ours, other, service_process())


async def _measure(large: Path, small: Path, ours: MapService, other: MapService, process: int) -> Result:
    for service in (ours, other):
        await asyncio.to_thread(service.jobs)  # what the first request loads is not the recording's
    idle = resident(process)
    before = await _copied(large)
    async with watched(process) as peak:
        began = time.perf_counter()
        upload = await asyncio.to_thread(ours.upload, large)
        sent = time.perf_counter() - began
        after = await _copied(large)
        began = time.perf_counter()
        job = await asyncio.to_thread(ours.submit, [upload.id])
        checked = time.perf_counter() - began
        began = time.perf_counter()
        done = await asyncio.to_thread(_whole_job, other, small)
        needed = time.perf_counter() - began
        seen = await asyncio.to_thread(_when_mapping, ours, job.id)
        await asyncio.to_thread(ours.cancel, job.id)
        last = await asyncio.to_thread(_until_over, ours, job.id)
    if done.state != "done" or last.state != "cancelled":
        raise InternalError(f"the small job is {done.state}, and the large one, which was cancelled, {last.state}")
    await asyncio.to_thread(ours.remove, job.id)
    meanwhile = seen.state == "running" and seen.stage == "mapping"
    return Result(
        upload.length, (before + after) / 2, sent, checked, idle, peak[0], needed, done.scans, meanwhile, seen.scans
    )


async def _copied(file: Path) -> float:
    """Seconds that `cp` takes on the same disk; neither it nor what comes next pays for what was written before."""
    copy = file.with_suffix(".copy")
    await asyncio.to_thread(os.sync)
    began = time.perf_counter()
    await asyncio.to_thread(subprocess.run, ["cp", str(file), str(copy)], check=True)
    passed = time.perf_counter() - began
    copy.unlink()
    await asyncio.to_thread(os.sync)
    return passed


def _when_mapping(service: MapService, job: str) -> Job:
    """The job as soon as scans of it are mapped, or when it is over."""
    return next(seen for seen in service.watch(job) if seen.scans > 0 or seen.state in OVER)


def _until_over(service: MapService, job: str) -> Job:
    *_, last = service.watch(job)
    return last


def _whole_job(service: MapService, recording: Path) -> Job:
    return _until_over(service, service.submit([service.upload(recording).id]).id)


def add_user(directory: Path) -> str:
    """Make another user in the Master's database; the password."""
    words = [*programs.command("user"), "--data-dir", str(directory), "add", OTHER]
    password = secrets.token_hex(16)
    subprocess.run(words, input=password.encode(), check=True, capture_output=True)
    return password


def service_process() -> int:
    """The map service that this process has started. NotFound."""
    for place in Path("/proc").iterdir():
        with contextlib.suppress(OSError):
            if place.name.isdigit() and PROGRAM in (place / "cmdline").read_bytes():
                parent = (place / "stat").read_text().rpartition(")")[2].split()[1]
                if int(parent) == os.getpid():
                    return int(place.name)
    raise NotFound("the platform runs without its map service: pip install '.[server]' in a checkout of RCE")


def resident(process: int) -> int:
    """Bytes of memory that a process holds."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


@contextlib.asynccontextmanager
async def watched(process: int) -> AsyncIterator[list[int]]:
    """The most memory that the process held meanwhile, as the only item of a list."""
    peak = [resident(process)]

    async def look() -> None:
        while True:
            peak[0] = max(peak[0], resident(process))
            await asyncio.sleep(LOOK_EVERY)

    watcher = asyncio.create_task(look())
    try:
        yield peak
    finally:
        watcher.cancel()


def as_data(result: Result) -> dict[str, Any]:
    return {field: getattr(result, field) for field in result.__struct_fields__}


def as_text(result: Result) -> str:
    size, grown = result.size / MEGABYTE, (result.peak - result.idle) / MEGABYTE
    copy, upload = size / result.copy, size / result.upload
    still = "was still being mapped" if result.meanwhile else "was over by then"
    return "\n".join(
        [
            f"recording         {size:.0f} MB",
            f"memory            {result.idle / MEGABYTE:.0f} MB idle, {grown:.0f} MB more at most",
            f"upload            {upload:.0f} MB/s, {upload / copy:.2f} of a copy on the same disk ({copy:.0f} MB/s)",
            f"check             {result.check:.1f} s until the job was accepted",
            f"another's job     {result.small_scans} scans in {result.small:.1f} s; the large one {still}",
        ]
    )
