"""`python -P -m rce.mapservice.job_program`: inspects or maps one recording, in a process of its own.

The separate process protects the service from large and malicious recordings. It reads the task as JSON from standard
input, which keeps the API key in it secret, and writes reports as JSON lines to standard output and the log to standard
error. On SIGTERM, which the kernel also sends when the service dies, it removes its environment and ends.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import itertools
import math
import os
import resource
import signal
import ssl
import sys
import time
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
from msgspec import Struct

from rce.api.map_jobs import MapOptions
from rce.errors import ErrorInfo, InvalidRequest, NotFound, RceError
from rce.services.disk import service_disk_full

if TYPE_CHECKING:  # the service reads the types of this module, and needs no client
    from rce.client import Robot

PR_SET_PDEATHSIG = 1
MAX_MEMORY = 3 * 1024**3  # bytes; the index of a recording of 10 GB takes some hundred MB
INSPECTED_SCANS = 20  # read before a job is accepted
REPORT_INTERVAL = 0.5  # seconds
NICENESS = 5  # uploads and the rest of the platform have priority


class Platform(Struct, frozen=True):
    """Platform and credentials for a job. `trust` is a PEM file with the platform's own certificate, or empty."""

    url: str
    user: str
    key: str
    trust: str = ""


class Task(Struct, frozen=True):
    """Task of the process: inspect a recording or, with `platform`, map it.

    Attributes:
        recording: Path of the recording, a file or a directory.
        options: Options for mapping.
        out: Directory for the results.
        name: Name of the environment.
        former: Names of the environments of earlier attempts, which may still exist.
        platform: Platform on which the recording is mapped.
    """

    recording: str
    options: MapOptions
    out: str = ""
    name: str = ""
    former: list[str] = []
    platform: Platform | None = None


class Report(Struct, frozen=True, omit_defaults=True):
    """Progress of a task. `clean` is true once nothing of the task is left on the platform."""

    stage: str = ""
    scans: int = 0
    total: int | None = None
    times: dict[str, float] = {}
    clean: bool = False
    error: ErrorInfo | None = None


def send(report: Report) -> None:
    """Write a report to standard output."""
    sys.stdout.buffer.write(msgspec.json.encode(report) + b"\n")
    sys.stdout.buffer.flush()


def inspect(task: Task) -> int | None:
    """Open the recording and read its first scans.

    Returns:
        The number of its scans, or None if the recording does not say.

    Raises:
        RceError: The recording cannot be mapped.
    """
    if task.options.kind == "3d":
        return _inspect_3d(task)
    from rce.mapping.files.recordings import open_recording

    total: int | None = 0
    try:
        for path in recordings_of(task):
            recording = open_recording(path, task.options.scan_topic, task.options.odometry_topic)
            if not list(itertools.islice(recording, INSPECTED_SCANS)):
                raise InvalidRequest(f"{recording.name} has no laser scans", field="path")
            total = None if total is None or recording.scans is None else total + recording.scans
    except (InvalidRequest, NotFound) as error:
        field = {"path": "uploads", "topic": "options.scan_topic"}.get(error.field, error.field)
        raise type(error)(str(error), field=field) from None
    return total


def recordings_of(task: Task) -> list[Path]:
    """Return the recordings of a task: its only file, a ROS 2 bag of several files, or several files by name."""
    path = Path(task.recording)
    if not path.is_dir() or (path / "metadata.yaml").exists():
        return [path]
    return sorted(path.iterdir())


def _inspect_3d(task: Task) -> int:
    """Open a recording of a camera with depth or of a lidar, read its first frame, and return the number of frames.

    Raises:
        RceError: The recording cannot be mapped.
    """
    from rce.mapping3d.files.recordings import open_recording

    if task.options.parallel > 1:
        raise InvalidRequest("recordings of kind 3d have one worker", field="options.parallel")
    try:
        recording = open_recording(Path(task.recording), topic=task.options.scan_topic)
        if next(iter(recording), None) is None:
            raise InvalidRequest(f"{recording.name} has no frames", field="path")
    except (InvalidRequest, NotFound) as error:
        field = {"path": "uploads", "camera": "uploads", "topic": "options.scan_topic"}.get(error.field, error.field)
        raise type(error)(str(error), field=field) from None
    return recording.frames


async def build_3d(task: Task, platform: Platform) -> None:
    """Map a recording of a camera or of a lidar in a new environment, as `rce map3d` does, and write the results."""
    from rce.mapping3d.files.recordings import open_recording
    from rce.mapping3d.offload.runs import map_with

    times = _Times()
    recording = open_recording(Path(task.recording), topic=task.options.scan_topic)
    times.end("opening")
    send(Report("preparing", 0, recording.frames, times.done))
    async with robot_of(task, platform) as robot:
        await remove_environments(robot, task, task.former)
        _, figures = await map_with([robot], task.name, [recording], Path(task.out), _Progress(times, recording.frames))
        times.end("mapping")
    send(Report("finishing", figures.frames, figures.frames, times.done, clean=True))
    log(f"{figures.frames} frames mapped")


def robot_of(task: Task, platform: Platform) -> Robot:
    """Return the robot that maps for a task; it is not connected yet."""
    from rce.client import Robot

    return Robot(
        platform.url,
        user=platform.user,
        robot=f"{task.name}_robot",
        key=platform.key,
        ssl=trust_only(platform.trust),
        timeout=180.0,
    )


async def build(task: Task, platform: Platform) -> None:
    """Map the recording in a new environment, as `rce map` does, and write the results."""
    from rce.mapping.files.outputs import write_outputs
    from rce.mapping.files.recordings import open_recording
    from rce.mapping.robot import MappingRobot

    times = _Times()
    recording = open_recording(Path(task.recording), task.options.scan_topic, task.options.odometry_topic)
    times.end("opening")
    send(Report("preparing", 0, recording.scans, times.done))
    async with robot_of(task, platform) as robot:
        await remove_environments(robot, task, task.former)
        async with robot.environment(task.name, restart="no") as environment:
            async with MappingRobot(robot, environment) as mapping:
                options = task.options
                await mapping.prepare(
                    {"mapper": options.mapper, "resolution": options.resolution, "max_range": options.max_range}
                )
                times.end("preparing")
                await mapping.drive(recording, _Progress(times, recording.scans))
                result = await mapping.result()
                times.end("mapping")
            send(Report("writing", result.scans, result.scans, times.done))
            await asyncio.to_thread(write_outputs, Path(task.out), result.grid, result.trajectory)
            times.end("writing")
    send(Report("finishing", result.scans, result.scans, times.done, clean=True))
    log(f"{result.scans} scans mapped")


async def build_parallel(task: Task, platform: Platform) -> None:
    """Map recordings by workers in environments of their own, and write the results."""
    from rce.mapping.files.outputs import write_joint_outputs
    from rce.mapping.files.recordings import open_recording
    from rce.mapping.mapper import MapperSettings
    from rce.mapping.parallel.run import Method, run

    times, options = _Times(), task.options
    recordings = [open_recording(path, options.scan_topic, options.odometry_topic) for path in recordings_of(task)]
    totals = [recording.scans for recording in recordings]
    total = None if None in totals else sum(each or 0 for each in totals)
    times.end("opening")

    def progress(scans: int) -> None:
        send(Report("mapping", min(scans, total or scans), total, times.done))

    send(Report("preparing", 0, total, times.done))
    async with robot_of(task, platform) as robot:
        await remove_environments(robot, task, task.former)
        method = Method(options.parallel, options.mapper, MapperSettings(options.resolution, options.max_range))
        done = await run(robot, task.name, recordings, method, progress)
        times.end("mapping")
    scans = sum(len(trajectory) for each in done.maps for trajectory in each.trajectories.values())
    send(Report("writing", scans, scans, times.done))
    for place, joint in enumerate(done.maps, 1):
        await asyncio.to_thread(write_joint_outputs, Path(task.out), place, joint.grid, joint.trajectories)
    times.end("writing")
    send(Report("finishing", scans, scans, times.done, clean=True))
    log(f"{scans} scans of {len(recordings)} recordings on {len(done.maps)} maps; workers lost: {done.lost}")


class _Times:
    """Durations of the consecutive stages, in seconds."""

    def __init__(self) -> None:
        self.done: dict[str, float] = {}
        self._begin = time.monotonic()

    def end(self, stage: str) -> None:
        now = time.monotonic()
        self.done[stage] = round(now - self._begin, 3)
        self._begin = now
        log(f"{stage}: {self.done[stage]} s")


class _Progress:
    """Reports how far a task has mapped its recording, at most once in REPORT_INTERVAL."""

    def __init__(self, times: _Times, total: int | None) -> None:
        self._times = times
        self._total = total
        self._last = -math.inf

    def __call__(self, done: int) -> None:
        if time.monotonic() - self._last > REPORT_INTERVAL:
            self._last = time.monotonic()
            send(Report("mapping", done, self._total, self._times.done))


async def remove_environments(robot: Robot, task: Task, attempts: Sequence[str]) -> None:
    """Remove the environments that may be left from attempts at a task, given by their names."""
    for attempt in attempts:
        for tag in (attempt, *(f"{attempt}_{member}" for member in range(task.options.parallel))):
            with contextlib.suppress(NotFound):
                await robot.destroy_environment(tag)


def trust_only(certificate: str) -> ssl.SSLContext | None:
    """Return a context that trusts only this certificate, whatever the host name; None if `certificate` is empty."""
    if not certificate:
        return None
    context = ssl.create_default_context(cafile=certificate)
    context.check_hostname = False
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    return context


def log(text: str) -> None:
    """Write a line to the log of the job."""
    with contextlib.suppress(OSError):  # a full disk must not end the job
        print(f"{time.strftime('%Y-%m-%dT%H:%M:%SZ', time.gmtime())} {text}", file=sys.stderr, flush=True)


async def run(task: Task) -> None:
    """Perform a task; SIGTERM and SIGINT cancel it."""
    current = asyncio.current_task()
    assert current is not None
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, current.cancel)
    if task.platform is None:
        total = await asyncio.to_thread(inspect, task)
        send(Report("inspected", 0, total, clean=True))
    else:
        await _builder(task)(task, task.platform)


def _builder(task: Task) -> Callable[[Task, Platform], Awaitable[None]]:
    if task.options.kind == "3d":
        return build_3d
    return build_parallel if task.options.parallel > 1 or len(recordings_of(task)) > 1 else build


def main() -> int:
    """Read a task, perform it and return the exit status."""
    parent = os.getppid()
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:
        return 1
    os.nice(NICENESS)
    resource.setrlimit(resource.RLIMIT_DATA, (MAX_MEMORY, MAX_MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    task = msgspec.json.decode(sys.stdin.buffer.read(), type=Task)
    try:
        asyncio.run(run(task))
    except asyncio.CancelledError:
        send(Report("cancelled", clean=True))
        return 1
    except RceError as error:
        log(f"{error.info.code}: {error}")
        send(Report("failed", clean=True, error=error.info))
        return 1
    except OSError as error:
        full = service_disk_full(error)
        if full is None:
            raise
        log(str(full))
        send(Report("failed", clean=True, error=full.info))
        return 1
    except MemoryError:
        text = "the recording needs more memory than a job may use: it is damaged or malicious"
        log(text)
        send(Report("failed", error=InvalidRequest(text, field="uploads").info))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
