"""Benchmark of maps of recordings.

It measures the times of upload and mapping by the map service (RoboWS, table 2 and figure 3b), and the cost and
accuracy of each mapper alone. A mapper alone runs in its own process, so that its memory can be measured; compiling is
not counted.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from msgspec import Struct

from rce.api.map_jobs import MapOptions
from rce.api.map_jobs import Mapper as MapperName
from rce.client.map_service import MapServiceClient
from rce.errors import InvalidRequest, RceError
from rce.mapping.evaluation.trials import Endless, Odometry, Relations, read_relations, run
from rce.mapping.evaluation.trials import endless as run_endless
from rce.mapping.evaluation.trials.endless import resident
from rce.mapping.files.outputs import write_outputs
from rce.mapping.files.recordings import open_recording
from rce.mapping.mappers import MAPPERS

OdometryName = Literal["recorded", "noisy", "worse", "none"]
ODOMETRY: dict[OdometryName, Odometry] = {
    "recorded": Odometry(),
    "noisy": Odometry(scale=1.03, noise=0.1),
    "worse": Odometry(scale=1.1, noise=0.1, slip=1.0),
    "none": Odometry(none=True),
}
ODOMETRIES: tuple[OdometryName, ...] = get_args(OdometryName)
RELATIONS = ".relations"
KILOBYTE = 1024
RESET_PEAK = Path("/proc/self/clear_refs")


class Recorded(Struct, frozen=True):
    """Recording to measure.

    Attributes:
        name: Name of the file.
        path: Path of the file or directory.
        size: Bytes.
        scans: Number of scans.
        messages: Number of scans and of poses of the odometry.
        way: Metres by the odometry.
        relations: File of true relations beside the recording, if there is one.
    """

    name: str
    path: Path
    size: int
    scans: int
    messages: int
    way: float
    relations: Path | None


class Served(Struct, frozen=True):
    """Result of the map service.

    Attributes:
        recording: Name of the recording.
        mapper: Name of the mapper.
        transmission: Seconds from the first byte to the last.
        mapping: Seconds from there until the recording was mapped.
    """

    recording: str
    mapper: MapperName
    transmission: float
    mapping: float


class Mapped(Struct, frozen=True):
    """Result of a mapper alone.

    Attributes:
        recording: Name of the recording.
        mapper: Name of the mapper.
        odometry: Name of the odometry.
        cpu: CPU seconds of all threads.
        elapsed: Elapsed seconds.
        memory: Bytes beyond the memory of the process before.
        errors: Metres and degrees by kind of relation; `benchmark` is the file beside the recording.
        closed: Whether loops are closed, None if there are none.
    """

    recording: str
    mapper: MapperName
    odometry: OdometryName
    cpu: float
    elapsed: float
    memory: int
    errors: dict[str, tuple[float, float]]
    closed: bool | None


class Results(Struct, frozen=True):
    """Results of all recordings."""

    recordings: list[Recorded]
    served: list[Served]
    mapped: list[Mapped]


def inspect_recording(path: Path) -> Recorded:
    """Read a recording once to count its messages.

    Raises:
        NotFound: The file does not exist.
        InvalidRequest: It is not a recording, or damaged.
    """
    scans, messages, way, last = 0, 0, 0.0, None
    for scan in open_recording(path):
        scans += 1
        messages += 1 + (scan.odometry is not None)
        if last is not None and scan.odometry is not None:
            way += math.hypot(scan.odometry[0] - last[0], scan.odometry[1] - last[1])
        last = scan.odometry
    files = [file for file in path.rglob("*") if file.is_file()] if path.is_dir() else [path]
    relations = path.with_name(path.name.partition(".")[0] + RELATIONS)
    size = sum(file.stat().st_size for file in files)
    return Recorded(path.name, path, size, scans, messages, way, relations if relations.exists() else None)


def odometries(recording: Recorded, wanted: Sequence[OdometryName]) -> Sequence[OdometryName]:
    """Return the odometries to measure.

    By default this is the recorded one, or a noisy one if the recorded one has to serve as the truth.
    """
    return wanted or (["recorded"] if recording.relations else ["noisy"])


async def serve(service: MapServiceClient, recording: Recorded, mapper: MapperName) -> Served:
    """Map a recording by the map service.

    Raises:
        RceError: The job failed.
    """
    files = sorted(recording.path.iterdir()) if recording.path.is_dir() else [recording.path]
    started = time.perf_counter()
    uploads = [(await asyncio.to_thread(service.upload, file)).id for file in files]
    sent = time.perf_counter() - started
    job = await asyncio.to_thread(service.submit, uploads, MapOptions(mapper=mapper), recording.name)
    *_, last = await asyncio.to_thread(lambda: list(service.watch(job.id)))
    if last.state != "done":
        raise RceError.from_info(last.error) if last.error else InvalidRequest(f"{recording.name}: {last.state}")
    await asyncio.to_thread(service.remove, job.id)
    return Served(recording.name, mapper, sent, last.times["mapping"])


def trials(
    recordings: Sequence[Recorded], mappers: Sequence[MapperName], wanted: Sequence[OdometryName], out: Path | None
) -> Iterator[Mapped]:
    """Yield the results of each mapper on each recording with each odometry, each in its own process.

    Args:
        recordings: The recordings.
        mappers: Names of the mappers.
        wanted: Names of the odometries; empty for the default.
        out: Directory for the maps; None for no maps.
    """
    for recording in recordings:
        for mapper in mappers:
            for odometry in odometries(recording, wanted):
                place = out / recording.name.partition(".")[0] / f"{mapper}-{odometry}" if out else None
                with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
                    yield process.submit(trial, recording, mapper, odometry, place).result()


def trial(recording: Recorded, mapper: MapperName, odometry: OdometryName, out: Path | None) -> Mapped:
    """Measure one mapper on one recording, and write its map to `out` unless it is None."""
    scans = list(open_recording(recording.path))
    before = resident()
    RESET_PEAK.write_text("5")
    started = time.perf_counter()
    done = run(MAPPERS[mapper], scans, ODOMETRY[odometry], _relations(recording, scans))
    elapsed = time.perf_counter() - started
    memory = peak_resident() - before
    if out is not None:
        write_outputs(out, done.grid, done.trajectory)
    errors = {
        kind: (error.translation, math.degrees(error.rotation))
        for kind, error in done.errors.items()
        if error.relations
    }
    return Mapped(recording.name, mapper, odometry, done.cpu, elapsed, memory, errors, done.closed)


def peak_resident() -> int:
    """Return the peak of the resident memory of this process since the last reset, bytes (Linux)."""
    status = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in status if line.startswith("VmHWM:")) * KILOBYTE


def endless(path: Path, mapper: MapperName, scans: int) -> Endless:
    """Map `scans` scans of a recording, forward, backward, forward ..., in its own process."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        return process.submit(_endless, path, mapper, scans).result()


def _endless(path: Path, mapper: MapperName, scans: int) -> Endless:
    return run_endless(MAPPERS[mapper], list(open_recording(path)), scans)


def _relations(recording: Recorded, scans: Sequence[Any]) -> dict[str, Relations] | None:
    """Return the true relations of a recording, if there are any."""
    if recording.relations is None:
        return None
    return {"benchmark": read_relations(recording.relations, np.array([scan.stamp for scan in scans]))}
