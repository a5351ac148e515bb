"""`python -P -m rce.mapservice.work`: one recording, looked at or mapped, in a process of its own.

So that a recording made to do harm, or a large one, costs the service neither memory nor time. The task comes as JSON
on standard input (a key in it is seen by nobody else), reports go as JSON lines to standard output, the log to standard
error. SIGTERM ends it after it has taken its environment away; so does the end of the service.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import itertools
import os
import resource
import signal
import ssl
import sys
import time
from pathlib import Path

import msgspec
from msgspec import Struct

from rce.errors import ErrorInfo, InvalidRequest, NotFound, RceError
from rce.map_jobs import MapOptions
from rce.mapservice.files import DiskFull

PR_SET_PDEATHSIG = 1
MEMORY = 3 * 1024**3  # bytes; the indices of a recording of 10 GB take some hundred MB
TRIED = 20  # scans that are read before a job is accepted
REPORT_EVERY = 0.5  # seconds
NICENESS = 5  # uploads and the platform itself go first


class Platform(Struct, frozen=True):
    """Where the job is done, and as whom; `trust`: a PEM file with the platform's own certificate."""

    url: str
    user: str
    key: str
    trust: str = ""


class Task(Struct, frozen=True):
    """A recording (a file or a directory); with a platform it is mapped and the results go to `out`.

    `name` is that of its environment, `former` those of earlier attempts that may be left.
    """

    recording: str
    options: MapOptions
    out: str = ""
    name: str = ""
    former: list[str] = []
    platform: Platform | None = None


class Report(Struct, frozen=True, omit_defaults=True):
    """How far it is. `clean`: nothing of it is left in the platform."""

    stage: str = ""
    scans: int = 0
    total: int | None = None
    times: dict[str, float] = {}
    clean: bool = False
    error: ErrorInfo | None = None


def say(report: Report) -> None:
    sys.stdout.buffer.write(msgspec.json.encode(report) + b"\n")
    sys.stdout.buffer.flush()


def look(task: Task) -> int | None:
    """Open the recording and read its first scans; how many it has. Raises RceError where it cannot be mapped."""
    from rce.mapping.recordings import open_recording

    try:
        recording = open_recording(Path(task.recording), task.options.scan_topic, task.options.odometry_topic)
        if not list(itertools.islice(recording, TRIED)):
            raise InvalidRequest(f"{recording.name} has no laser scans", field="path")
    except (InvalidRequest, NotFound) as error:
        field = {"path": "uploads", "topic": "options.scan_topic"}.get(error.field, error.field)
        raise type(error)(str(error), field=field) from None
    return recording.scans


async def build(task: Task, platform: Platform) -> None:
    """Map the recording in an environment of its own, as `rce map` does."""
    from rce.client import Robot
    from rce.mapping.outputs import write_outputs
    from rce.mapping.recordings import open_recording
    from rce.mapping.robot import MappingRobot

    times = _Times()
    recording = open_recording(Path(task.recording), task.options.scan_topic, task.options.odometry_topic)
    times.end("opening")
    robot = Robot(
        platform.url,
        user=platform.user,
        robot=f"{task.name}_robot",
        key=platform.key,
        ssl=trusting(platform.trust),
        timeout=180.0,
    )
    shown = 0.0

    def progress(scans: int) -> None:
        nonlocal shown
        if time.monotonic() - shown > REPORT_EVERY:
            shown = time.monotonic()
            say(Report("mapping", scans, recording.scans, times.done))

    say(Report("preparing", 0, recording.scans, times.done))
    async with robot:
        for former in task.former:
            await remove_environment(robot, former)
        async with robot.environment(task.name, restart="no") as environment:
            async with MappingRobot(robot, environment) as mapping:
                options = task.options
                await mapping.prepare(
                    {"mapper": options.mapper, "resolution": options.resolution, "max_range": options.max_range}
                )
                times.end("preparing")
                await mapping.drive(recording, progress)
                result = await mapping.result()
                times.end("mapping")
            say(Report("writing", result.scans, result.scans, times.done))
            await asyncio.to_thread(write_outputs, Path(task.out), result.grid, result.trajectory)
            times.end("writing")
    say(Report("finishing", result.scans, result.scans, times.done, clean=True))
    log(f"{result.scans} scans mapped")


class _Times:
    """Seconds of each stage, one after the other."""

    def __init__(self) -> None:
        self.done: dict[str, float] = {}
        self._begin = time.monotonic()

    def end(self, stage: str) -> None:
        now = time.monotonic()
        self.done[stage] = round(now - self._begin, 3)
        self._begin = now
        log(f"{stage}: {self.done[stage]} s")


async def remove_environment(robot: object, tag: str) -> None:
    """Take an environment away that may be left from an earlier attempt."""
    from rce.client import Robot

    assert isinstance(robot, Robot)
    try:
        await robot.destroy_environment(tag)
    except NotFound:
        return


def trusting(certificate: str) -> ssl.SSLContext | None:
    """Trust in exactly the platform's own certificate, whatever the name by which it is reached."""
    if not certificate:
        return None
    context = ssl.create_default_context(cafile=certificate)
    context.check_hostname = False
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    return context


def log(text: str) -> None:
    with contextlib.suppress(OSError):  # the disk is full: no reason to end
        print(f"{time.strftime('%Y-%m-%dT%H:%M:%SZ', time.gmtime())} {text}", file=sys.stderr, flush=True)


async def run(task: Task) -> None:
    current = asyncio.current_task()
    assert current is not None
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, current.cancel)
    if task.platform is None:
        total = await asyncio.to_thread(look, task)
        say(Report("looked", 0, total, clean=True))
    else:
        await build(task, task.platform)


def main() -> int:
    parent = os.getppid()
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:
        return 1
    os.nice(NICENESS)
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    task = msgspec.json.decode(sys.stdin.buffer.read(), type=Task)
    try:
        asyncio.run(run(task))
    except asyncio.CancelledError:
        say(Report("cancelled", clean=True))
        return 1
    except RceError as error:
        log(f"{error.info.code}: {error}")
        say(Report("failed", clean=True, error=error.info))
        return 1
    except OSError as error:
        full = DiskFull.of(error)
        if full is None:
            raise
        log(str(full))
        say(Report("failed", clean=True, error=full.info))
        return 1
    except MemoryError:
        text = "the recording needs more memory than a job may have: it is damaged, or made to do so"
        log(text)
        say(Report("failed", error=InvalidRequest(text, field="uploads").info))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
