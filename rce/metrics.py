"""What a process counts of itself, for Prometheus: counters and timings that cost next to nothing until they are read.

They are plain numbers, because messages pass by the ten thousand: `observe` of prometheus_client takes 2 µs, and its
import 40 ms of each start of an environment. The Master, who is asked for the text, makes it with that library
(`rce.exposition`) of the families that processes answer to `ReadMetrics`.

Counters and timings of a module count for the whole process. What is there at present (gauges, and counts that
somebody keeps in any case) is told by functions that give families when they are asked.
"""

from __future__ import annotations

import os
import resource
import time
from bisect import bisect_left
from collections.abc import Callable, Iterable, Mapping
from typing import Literal

from msgspec import Struct

import rce

QUICK = (0.00005, 0.0001, 0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 1.0)
"""Bounds in seconds for what a process does with a message."""
LONG = (0.001, 0.005, 0.01, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
"""Bounds in seconds for what somebody waits for."""
LAG_EVERY = 1.0


class Sample(Struct, frozen=True):
    """A value by the values of its labels. Of a histogram: how many in each bucket, the last beyond all bounds."""

    labels: list[str]
    value: float  # of a histogram: the sum of what was observed
    counts: list[int] = []


class Family(Struct, frozen=True):
    """A metric with all its samples. Counters are named without `_total`."""

    name: str
    help: str
    kind: Literal["counter", "gauge", "histogram"]
    labels: list[str] = []
    samples: list[Sample] = []
    bounds: list[float] = []  # of a histogram, rising


Source = Callable[[], Iterable[Family]]
_kept: list[Counter | Timing] = []


class Counter:
    """Made once, at the top of a module."""

    def __init__(self, name: str, help: str, *labels: str) -> None:
        self._about = (name, help, list(labels))
        self._values: dict[tuple[str, ...], int] = {} if labels else {(): 0}
        _kept.append(self)

    def add(self, *labels: str, by: int = 1) -> None:
        self._values[labels] = self._values.get(labels, 0) + by

    def family(self) -> Family:
        name, help, labels = self._about
        return counted(name, help, labels, self._values)


class Observed:
    """The observations under one set of labels; one thread observes."""

    __slots__ = ("_bounds", "counts", "sum")

    def __init__(self, bounds: tuple[float, ...]) -> None:
        self._bounds = bounds
        self.counts = [0] * (len(bounds) + 1)
        self.sum = 0.0

    def observe(self, seconds: float) -> None:
        self.counts[bisect_left(self._bounds, seconds)] += 1
        self.sum += seconds

    def since(self, began: float) -> None:
        """`began` is a time of `time.perf_counter`."""
        self.observe(time.perf_counter() - began)


class Timing:
    """A histogram of seconds. Made once, at the top of a module."""

    def __init__(self, name: str, help: str, *labels: str, bounds: tuple[float, ...] = LONG) -> None:
        self._about = (name, help, list(labels))
        self._bounds = bounds
        self._observed: dict[tuple[str, ...], Observed] = {}
        _kept.append(self)

    def of(self, *labels: str) -> Observed:
        found = self._observed.get(labels)
        if found is None:
            found = self._observed[labels] = Observed(self._bounds)
        return found

    def family(self) -> Family:
        name, help, labels = self._about
        samples = [Sample(list(key), each.sum, each.counts) for key, each in self._observed.items()]
        return Family(name, help, "histogram", labels, samples, list(self._bounds))


def counted(name: str, help: str, labels: Iterable[str], values: Mapping[tuple[str, ...], float]) -> Family:
    """A counter whose values somebody keeps."""
    return Family(name, help, "counter", list(labels), [Sample(list(key), value) for key, value in values.items()])


def gauge(name: str, help: str, labels: Iterable[str], values: Mapping[tuple[str, ...], float]) -> Family:
    """Values as they are now."""
    return Family(name, help, "gauge", list(labels), [Sample(list(key), value) for key, value in values.items()])


def with_parts(own: Iterable[Family], label: str, parts: Mapping[str, Iterable[Family]]) -> list[Family]:
    """The families of a process and of its parts in one list: one more label says which part a sample is of.

    Of the process itself it is empty, which Prometheus takes for none. What a part of another version tells in another
    form is left out.
    """
    found: dict[str, Family] = {}
    for part, told in {"": own, **parts}.items():
        for each in told:
            empty = Family(each.name, each.help, each.kind, [*each.labels, label], [], each.bounds)
            known = found.setdefault(each.name, empty)
            if (known.kind, known.labels, known.bounds) == (empty.kind, empty.labels, empty.bounds):
                known.samples.extend(Sample([*one.labels, part], one.value, one.counts) for one in each.samples)
    return list(found.values())


def families(role: str, *sources: Source) -> list[Family]:
    """All that this process tells: of itself as a process, of its modules, and of these sources."""
    return [
        gauge("rce_info", "What this process is", ["role", "version"], {(role, rce.__version__): 1}),
        *_process(),
        *(each.family() for each in _kept),
        *(family for source in sources for family in source()),
    ]


def _process() -> list[Family]:
    """Under the names that all libraries for Prometheus give them."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    with open("/proc/self/statm") as file:
        resident = int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return [
        counted("process_cpu_seconds", "Processor time", [], {(): used.ru_utime + used.ru_stime}),
        gauge("process_resident_memory_bytes", "Memory", [], {(): resident}),
        gauge("process_open_fds", "Open files", [], {(): len(os.listdir("/proc/self/fd"))}),
        gauge("process_start_time_seconds", "When it began, in seconds since 1970", [], {(): _BEGAN}),
    ]


_BEGAN = time.time()
errors = Counter("rce_errors", "Errors that were answered: to processes, to robots, over HTTP", "to", "code")
_lag = Timing("rce_event_loop_lag_seconds", "How late the event loop did what was due", bounds=QUICK)


async def watch_loop() -> None:
    """Observe the lag of this process's event loop, until cancelled."""
    import asyncio  # the console knows the types of this module, and would start half as fast again

    loop, lag = asyncio.get_running_loop(), _lag.of()
    while True:
        due = loop.time() + LAG_EVERY
        await asyncio.sleep(LAG_EVERY)
        lag.observe(max(0.0, loop.time() - due))
