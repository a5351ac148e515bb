"""Recordings and what becomes of them: how long it takes to send them and to have them mapped by the map service
(RoboWS, Table 2 and Figure 3b), and what each mapper needs by itself and how good its map is.

The mapper by itself runs in a process of its own, so that its memory is its own; compiling is not counted.
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

from rce.client.map_service import MapService
from rce.errors import InvalidRequest, RceError
from rce.map_jobs import MapOptions
from rce.map_jobs import Mapper as MapperName
from rce.mapping.mappers import MAPPERS
from rce.mapping.outputs import write_outputs
from rce.mapping.recordings import open_recording
from rce.mapping.trials import Endless, Odometry, Relations, read_relations, run
from rce.mapping.trials import endless as run_endless
from rce.mapping.trials.endless import resident

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
    """A recording; `messages` are its scans and poses of the odometry, `size` bytes, `way` metres by the odometry."""

    name: str
    path: Path
    size: int
    scans: int
    messages: int
    way: float
    relations: Path | None  # the file of true relations that lies beside it


class Served(Struct, frozen=True):
    """By the map service: seconds from the first byte to the last, and from there until the map was mapped."""

    recording: str
    mapper: MapperName
    transmission: float
    mapping: float


class Mapped(Struct, frozen=True):
    """By the mapper itself: CPU seconds of all its threads, elapsed seconds, and bytes that it took beyond what its
    process had before. `errors` by kind of relation: metres, degrees (`rce.mapping.trials.relations`); `benchmark`
    are those of the file beside the recording.
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
    recordings: list[Recorded]
    served: list[Served]
    mapped: list[Mapped]


def look(path: Path) -> Recorded:
    """Read a recording once. InvalidRequest, NotFound."""
    scans, messages, way, last = 0, 0, 0.0, None
    for scan in open_recording(path):
        scans += 1
        messages += 1 + (scan.odometry is not None)
        if last is not None and scan.odometry is not None:
            way += math.hypot(scan.odometry[0] - last[0], scan.odometry[1] - last[1])
        last = scan.odometry
    files = [file for file in path.rglob("*") if file.is_file()] if path.is_dir() else [path]
    beside = path.with_name(path.name.partition(".")[0] + RELATIONS)
    size = sum(file.stat().st_size for file in files)
    return Recorded(path.name, path, size, scans, messages, way, beside if beside.exists() else None)


def odometries(recording: Recorded, wanted: Sequence[OdometryName]) -> Sequence[OdometryName]:
    """Those that are wanted; else the recorded one, or a noisy one where the recorded one has to be the truth."""
    return wanted or (["recorded"] if recording.relations else ["noisy"])


async def serve(service: MapService, recording: Recorded, mapper: MapperName) -> Served:
    """Have it mapped by the map service. RceError if the job fails."""
    files = sorted(recording.path.iterdir()) if recording.path.is_dir() else [recording.path]
    began = time.perf_counter()
    uploads = [(await asyncio.to_thread(service.upload, file)).id for file in files]
    sent = time.perf_counter() - began
    job = await asyncio.to_thread(service.submit, uploads, MapOptions(mapper=mapper), recording.name)
    *_, last = await asyncio.to_thread(lambda: list(service.watch(job.id)))
    if last.state != "done":
        raise RceError.from_info(last.error) if last.error else InvalidRequest(f"{recording.name}: {last.state}")
    await asyncio.to_thread(service.remove, job.id)
    return Served(recording.name, mapper, sent, last.times["mapping"])


def trials(
    recordings: Sequence[Recorded], mappers: Sequence[MapperName], wanted: Sequence[OdometryName], out: Path | None
) -> Iterator[Mapped]:
    """Each mapper on each recording with each odometry, one after the other, each in a process of its own."""
    for recording in recordings:
        for mapper in mappers:
            for odometry in odometries(recording, wanted):
                place = out / recording.name.partition(".")[0] / f"{mapper}-{odometry}" if out else None
                with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
                    yield process.submit(trial, recording, mapper, odometry, place).result()


def trial(recording: Recorded, mapper: MapperName, odometry: OdometryName, out: Path | None) -> Mapped:
    """One mapper on one recording; its map is written to `out`."""
    scans = list(open_recording(recording.path))
    before = resident()
    RESET_PEAK.write_text("5")
    began = time.perf_counter()
    done = run(MAPPERS[mapper], scans, ODOMETRY[odometry], _relations(recording, scans))
    elapsed = time.perf_counter() - began
    memory = most_resident() - before
    if out is not None:
        write_outputs(out, done.grid, done.trajectory)
    errors = {
        kind: (error.translation, math.degrees(error.rotation))
        for kind, error in done.errors.items()
        if error.relations
    }
    return Mapped(recording.name, mapper, odometry, done.cpu, elapsed, memory, errors, done.closed)


def most_resident() -> int:
    """The most bytes of memory that this process had since the last reset. Linux."""
    status = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in status if line.startswith("VmHWM:")) * KILOBYTE


def endless(path: Path, mapper: MapperName, scans: int) -> Endless:
    """So many scans of a recording, forward, back, forward…, in a process of its own."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        return process.submit(_endless, path, mapper, scans).result()


def _endless(path: Path, mapper: MapperName, scans: int) -> Endless:
    return run_endless(MAPPERS[mapper], list(open_recording(path)), scans)


def _relations(recording: Recorded, scans: Sequence[Any]) -> dict[str, Relations] | None:
    if recording.relations is None:
        return None
    return {"benchmark": read_relations(recording.relations, np.array([scan.stamp for scan in scans]))}
