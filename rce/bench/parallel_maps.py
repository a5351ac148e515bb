"""Benchmark of mapping by several workers: speed-up, and what the exchange of units costs.

The times of the units with one worker also tell how long more machines would take: each phase is scheduled on them, and
what the job does by itself between the units stays.
"""

from __future__ import annotations

import heapq
import time
from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any

import msgspec
from msgspec import Struct

from rce.bench.report import aligned, machine
from rce.client import Robot
from rce.mapping.mapper import MapperSettings
from rce.mapping.parallel.crew import UnitRecord
from rce.mapping.parallel.run import Method, run
from rce.mapping.scans import Scan

MACHINES = (1, 2, 4, 8, 16)  # for which the time is computed
SHARE = 0.3  # of a cut piece that it has in common with the next one
MEGABYTE = 1e6


class KindOfUnit(Struct, frozen=True):
    """Units of one kind.

    Attributes:
        kind: Tag of the work.
        units: Number of units.
        seconds: Elapsed seconds of the work.
        exchange: Seconds that units waited beyond the work.
        sent: Bytes to workers.
        received: Bytes from workers.
    """

    kind: str
    units: int
    seconds: float
    exchange: float
    sent: int
    received: int


class Figure(Struct, frozen=True):
    """Result with a number of workers.

    Attributes:
        workers: Number of workers.
        seconds: Elapsed seconds of the job, from the first environment to the maps.
        speedup: Seconds with the fewest workers by these seconds.
        maps: Number of maps.
        kinds: The units.
    """

    workers: int
    seconds: float
    speedup: float
    maps: int
    kinds: list[KindOfUnit]


class Computed(Struct, frozen=True):
    """Time that a number of machines would take, with a worker on each.

    Attributes:
        machines: Number of machines.
        seconds: Computed seconds.
        speedup: Seconds with one machine by these seconds.
    """

    machines: int
    seconds: float
    speedup: float


class Result(Struct, frozen=True):
    """Result of the benchmark.

    Attributes:
        recordings: Number of recordings.
        scans: Number of scans.
        figures: Measured, by number of workers.
        computed: Computed from the units of the run with the fewest workers.
    """

    recordings: int
    scans: int
    figures: list[Figure]
    computed: list[Computed]


def cut(scans: Sequence[Scan], count: int) -> list[Sequence[Scan]]:
    """Return a recording as `count` recordings that overlap, as if robots had driven one after the other."""
    if count == 1:
        return [scans]
    step = len(scans) / (count + SHARE)
    return [scans[round(step * number) : round(step * (number + 1 + SHARE))] for number in range(count)]


async def measure(robot: Robot, recordings: Sequence[Sequence[Scan]], workers: Iterable[int]) -> Result:
    """Map recordings with each number of workers.

    Raises:
        RceError: A run failed.
    """
    figures: list[Figure] = []
    first: tuple[float, list[UnitRecord]] | None = None
    for count in sorted(workers):
        began = time.perf_counter()
        done = await run(robot, f"bench_{count}", recordings, Method(count, "graph", MapperSettings()))
        seconds = time.perf_counter() - began
        first = first or (seconds, done.units)
        figures.append(Figure(count, seconds, first[0] / seconds, len(done.maps), kinds(done.units)))
    computed = [] if first is None else list(compute(*first, figures[0].workers))
    return Result(len(recordings), sum(map(len, recordings)), figures, computed)


def kinds(units: Iterable[UnitRecord]) -> list[KindOfUnit]:
    """Return the sums of the units of each kind, in the order in which the kinds begin."""
    by_kind: dict[str, list[UnitRecord]] = defaultdict(list)
    for unit in units:
        by_kind[unit.kind].append(unit)
    return [
        KindOfUnit(
            kind,
            len(each),
            sum(unit.seconds for unit in each),
            sum(unit.waited - unit.seconds for unit in each),
            sum(unit.sent for unit in each),
            sum(unit.received for unit in each),
        )
        for kind, each in by_kind.items()
    ]


def compute(seconds: float, units: Sequence[UnitRecord], workers: int) -> Iterable[Computed]:
    """Yield the computed time for each of MACHINES.

    Args:
        seconds: Measured seconds of a job.
        units: Its units.
        workers: Number of its workers.
    """
    rest = max(seconds - scheduled(units, workers), 0.0)
    alone = rest + scheduled(units, 1)
    for machines in MACHINES:
        total = rest + scheduled(units, machines)
        yield Computed(machines, total, alone / total)


def scheduled(units: Iterable[UnitRecord], machines: int) -> float:
    """Return the seconds that units take if each is given to the machine that is free first, phase by phase."""
    phases: dict[int, list[float]] = defaultdict(list)
    for unit in units:
        phases[unit.phase].append(unit.waited)
    total = 0.0
    for phase in phases.values():
        free = [0.0] * machines
        for seconds in phase:
            heapq.heapreplace(free, free[0] + seconds)
        total += max(free)
    return total


def as_data(result: Result) -> dict[str, Any]:
    """Return the result for JSON."""
    data: dict[str, Any] = {"machine": machine(), **msgspec.to_builtins(result)}
    return data


def as_text(result: Result) -> str:
    """Return the result as tables."""
    host = machine()
    lines = [
        f"{result.recordings} recordings, {result.scans} scans; {host['processor']}, {host['cores']} cores, "
        f"load {host['load']:.1f}",
        "",
        *aligned([("workers", "seconds", "speed-up", "maps"), *_figures(result)]),
        "",
        *aligned([("workers", "unit", "number", "work s", "exchange s", "MB out", "MB back"), *_units(result)]),
        "",
        f"computed from the units with {result.figures[0].workers} workers, each on a machine of its own:",
        *aligned([("machines", "seconds", "speed-up"), *_computed(result)]),
    ]
    return "\n".join(lines)


def _figures(result: Result) -> list[tuple[str, ...]]:
    return [(f"{e.workers}", f"{e.seconds:.1f}", f"{e.speedup:.2f}", f"{e.maps}") for e in result.figures]


def _units(result: Result) -> list[tuple[str, ...]]:
    return [
        (
            f"{figure.workers}",
            each.kind,
            f"{each.units}",
            f"{each.seconds:.1f}",
            f"{each.exchange:.1f}",
            f"{each.sent / MEGABYTE:.1f}",
            f"{each.received / MEGABYTE:.1f}",
        )
        for figure in result.figures
        for each in figure.kinds
    ]


def _computed(result: Result) -> list[tuple[str, ...]]:
    return [(f"{each.machines}", f"{each.seconds:.1f}", f"{each.speedup:.2f}") for each in result.computed]
