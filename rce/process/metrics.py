"""Metrics of a process, for Prometheus: counters and histograms that cost almost nothing until they are read.

They are plain numbers instead of the objects of prometheus_client, because processes handle tens of thousands of
messages per second: `observe` of prometheus_client takes 2 µs, and its import adds 40 ms to each start of an
environment. Processes answer `ReadMetrics` with families, which the Master formats with that library
(`rce.process.exposition`).

Counters and histograms are module variables and count for the whole process. Gauges, and counts that are kept anyway,
come from functions (`Source`) that return families when metrics are read.
"""

from __future__ import annotations

import os
import resource
import sys
import time
from bisect import bisect_left
from collections.abc import Callable, Iterable, Mapping
from typing import Literal

from msgspec import Struct

import rce

MESSAGE_BUCKETS = (0.00005, 0.0001, 0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 1.0)
"""Upper bounds in seconds for the handling of messages."""
REQUEST_BUCKETS = (0.001, 0.005, 0.01, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
"""Upper bounds in seconds for operations that somebody waits for."""
LAG_INTERVAL = 1.0  # seconds


class Sample(Struct, frozen=True):
    """Value of a metric for one set of label values.

    Attributes:
        labels: Values of the labels, in the order of `Family.labels`.
        value: The value; for a histogram, the sum of the observations.
        counts: For a histogram, the number of observations in each bucket; the last bucket is above all bounds.
    """

    labels: list[str]
    value: float
    counts: list[int] = []


class Family(Struct, frozen=True):
    """Metric with all of its samples. The names of counters have no `_total`."""

    name: str
    help: str
    kind: Literal["counter", "gauge", "histogram"]
    labels: list[str] = []
    samples: list[Sample] = []
    bounds: list[float] = []  # upper bounds of a histogram's buckets, ascending


Source = Callable[[], Iterable[Family]]
_registered: list[Counter | Timing] = []


class Counter:
    """Count events, by the values of labels. Create each counter once, as a module variable."""

    def __init__(self, name: str, help: str, *labels: str) -> None:
        self._description = (name, help, list(labels))
        self._values: dict[tuple[str, ...], int] = {} if labels else {(): 0}
        _registered.append(self)

    def add(self, *labels: str, by: int = 1) -> None:
        """Increase the counter for these label values."""
        self._values[labels] = self._values.get(labels, 0) + by

    def family(self) -> Family:
        """Return the metric as a family."""
        name, help, labels = self._description
        return counter_family(name, help, labels, self._values)


class Observed:
    """Observations of a histogram for one set of label values. Only one thread may add observations."""

    __slots__ = ("_bounds", "counts", "sum")

    def __init__(self, bounds: tuple[float, ...]) -> None:
        self._bounds = bounds
        self.counts = [0] * (len(bounds) + 1)
        self.sum = 0.0

    def observe(self, seconds: float) -> None:
        """Add an observation."""
        self.counts[bisect_left(self._bounds, seconds)] += 1
        self.sum += seconds

    def observe_since(self, began: float) -> None:
        """Add the time since `began`, which is a time of `time.perf_counter`."""
        self.observe(time.perf_counter() - began)


class Timing:
    """Histogram of durations in seconds. Create it once, as a module variable."""

    def __init__(self, name: str, help: str, *labels: str, bounds: tuple[float, ...] = REQUEST_BUCKETS) -> None:
        self._description = (name, help, list(labels))
        self._bounds = bounds
        self._observed: dict[tuple[str, ...], Observed] = {}
        _registered.append(self)

    def labels(self, *labels: str) -> Observed:
        """Return the observations for these label values."""
        found = self._observed.get(labels)
        if found is None:
            found = self._observed[labels] = Observed(self._bounds)
        return found

    def family(self) -> Family:
        """Return the metric as a family."""
        name, help, labels = self._description
        samples = [Sample(list(key), each.sum, each.counts) for key, each in self._observed.items()]
        return Family(name, help, "histogram", labels, samples, list(self._bounds))


def counter_family(name: str, help: str, labels: Iterable[str], values: Mapping[tuple[str, ...], float]) -> Family:
    """Return a counter with values that are kept elsewhere."""
    return Family(name, help, "counter", list(labels), [Sample(list(key), value) for key, value in values.items()])


def gauge_family(name: str, help: str, labels: Iterable[str], values: Mapping[tuple[str, ...], float]) -> Family:
    """Return a gauge with the present values."""
    return Family(name, help, "gauge", list(labels), [Sample(list(key), value) for key, value in values.items()])


def merge_families(own: Iterable[Family], label: str, parts: Mapping[str, Iterable[Family]]) -> list[Family]:
    """Merge the families of a process and of its parts.

    Args:
        own: Families of the process itself.
        label: Name of an additional label for the part; it is empty, and so missing for Prometheus, in `own`.
        parts: Families by part.

    Returns:
        The merged families. A family of a part is left out if its kind, labels or bounds differ, as those of a part
        with another version may.
    """
    found: dict[str, Family] = {}
    for part, its_families in {"": own, **parts}.items():
        for each in its_families:
            empty = Family(each.name, each.help, each.kind, [*each.labels, label], [], each.bounds)
            known = found.setdefault(each.name, empty)
            if (known.kind, known.labels, known.bounds) == (empty.kind, empty.labels, empty.bounds):
                known.samples.extend(Sample([*one.labels, part], one.value, one.counts) for one in each.samples)
    return list(found.values())


def collect_families(role: str, *sources: Source) -> list[Family]:
    """Return all families of this process: of the process as such, of its modules, and of `sources`."""
    return [
        gauge_family("rce_info", "Role and version of the process", ["role", "version"], {(role, rce.__version__): 1}),
        *_process(),
        *(each.family() for each in _registered),
        *(family for source in sources for family in source()),
    ]


def _process() -> list[Family]:
    """Return the standard process metrics, with the names that all Prometheus client libraries use."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    with open("/proc/self/statm") as file:
        resident = int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return [
        counter_family("process_cpu_seconds", "Processor time", [], {(): used.ru_utime + used.ru_stime}),
        gauge_family("process_resident_memory_bytes", "Memory", [], {(): resident}),
        gauge_family("process_open_fds", "Open files", [], {(): len(os.listdir("/proc/self/fd"))}),
        gauge_family("rce_tasks", "Tasks of the event loop", [], {(): _count_tasks()}),
        gauge_family("process_start_time_seconds", "Start time in seconds since 1970", [], {(): _STARTED_AT}),
    ]


def _count_tasks() -> int:
    asyncio = sys.modules.get("asyncio")  # see `watch_loop`
    try:
        return len(asyncio.all_tasks()) if asyncio is not None else 0
    except RuntimeError:
        return 0  # no loop runs here


_STARTED_AT = time.time()
errors = Counter("rce_errors", "Errors sent to processes, to robots and over HTTP", "to", "code")
_lag = Timing("rce_event_loop_lag_seconds", "Delay of the event loop behind its schedule", bounds=MESSAGE_BUCKETS)


async def watch_loop() -> None:
    """Observe the lag of this process's event loop until cancelled."""
    import asyncio  # imported late: the console imports this module, and asyncio would make its start 50 % slower

    loop, lag = asyncio.get_running_loop(), _lag.labels()
    while True:
        due = loop.time() + LAG_INTERVAL
        await asyncio.sleep(LAG_INTERVAL)
        lag.observe(max(0.0, loop.time() - due))
