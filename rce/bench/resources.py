"""Memory, descriptors and tasks of a platform's processes over time, and whether they grow."""

from __future__ import annotations

import contextlib
import os
import re
import statistics
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import psutil
from msgspec import Struct, field

from rce.api.http import EntryClient
from rce.errors import RceError

WARM_UP = 1 / 3  # share of a run that is not judged: caches and the allocators' pools fill
FLAT = 0.02  # growth over the judged time, as a share of the mean
PROGRAMS = {
    "master": ("Master", "metrics"),
    "endpoints.robot": ("Robot endpoint", "metrics/robot-1"),
    "containers": ("task set", "metrics/machine-1"),
    "rce.mapservice": ("map service", "metrics/map-service"),
}
"""Name and path of the metrics of each program that `rce up` starts."""
_ROLLUP = re.compile(r"^(\w+): +(\d+) kB$", re.MULTILINE)
_TASKS = re.compile(r"^rce_tasks(?:{[^}]*})? (\S+)$", re.MULTILINE)


class Series(Struct):
    """Samples of one process, or of a directory. The lists are as long as `times`, which are in seconds.

    Attributes:
        times: Seconds since the begin.
        figures: Samples by kind: `memory` (see `own_memory`) and `database` are in bytes, the others are numbers.
    """

    times: list[float] = field(default_factory=list)
    figures: dict[str, list[float]] = field(default_factory=dict)

    def add(self, time: float, **figures: float) -> None:
        """Add one sample of each kind."""
        self.times.append(time)
        for kind, value in figures.items():
            self.figures.setdefault(kind, []).append(value)


class Trend(NamedTuple):
    """Trend of one kind of figure after the warm-up.

    Attributes:
        first: Value of the line at the end of the warm-up.
        last: Value of the line at the end.
        growth: Growth between the two as a share of the mean.
        hourly: Slope in an hour.
    """

    first: float
    last: float
    growth: float
    hourly: float

    @property
    def flat(self) -> bool:
        """Return True if the figure does not grow."""
        return self.growth <= FLAT


def trend(series: Series, kind: str) -> Trend:
    """Return the line of least squares through the samples after the warm-up."""
    begin = series.times[0] + WARM_UP * (series.times[-1] - series.times[0])
    judged = [pair for pair in zip(series.times, series.figures[kind], strict=True) if pair[0] >= begin]
    times, values = [time for time, _ in judged], [value for _, value in judged]
    if len(judged) < 2:
        return Trend(values[-1], values[-1], 0.0, 0.0)
    slope, base = statistics.linear_regression(times, values)
    first, last = base + slope * times[0], base + slope * times[-1]
    mean = statistics.fmean(values)
    return Trend(first, last, (last - first) / mean if mean else 0.0, slope * 3600)


class Observer:
    """Samples the processes of a platform that this process has started.

    Attributes:
        series: Samples by name of the process; `data` is the platform's directory.
        restarts: Names of processes that ended and were started again.
    """

    def __init__(self, directory: Path, metrics: EntryClient, environment: str) -> None:
        """Observe a platform.

        Args:
            directory: Its data.
            metrics: Client of a user who may read metrics.
            environment: Environment that lasts, as `user/tag`; others are not observed.
        """
        self.series: dict[str, Series] = {}
        self.restarts: list[str] = []
        self._directory = directory
        self._metrics = metrics
        self._environment = environment
        self._pids: dict[str, int] = {}

    def sample(self, time: float) -> None:
        """Take one sample of everything; it takes some 100 ms, most of it in reading tables of pages."""
        for name, path, process in self._processes():
            if self._pids.setdefault(name, process.pid) != process.pid:
                self._pids[name] = process.pid
                self.restarts.append(name)
            with contextlib.suppress(psutil.Error, RceError, OSError):  # it has just ended
                taken = {
                    "memory": own_memory(process.pid),
                    "descriptors": process.num_fds(),
                    "threads": process.num_threads(),
                    "tasks": self._tasks(path),
                }
                self.series.setdefault(name, Series()).add(time, **taken)
        # Not `rglob`, which fails if a directory is removed meanwhile, as those of environments are.
        files = [Path(root, name) for root, below, names in os.walk(self._directory) for name in (*below, *names)]
        database = sum(_size(path) for path in files if path.name.startswith("master.db"))
        self.series.setdefault("data", Series()).add(time, database=database, files=len(files))

    def _processes(self) -> Iterator[tuple[str, str, psutil.Process]]:
        """Yield name, path of the metrics, and process of each program that is observed."""
        for process in psutil.Process().children(recursive=True):
            with contextlib.suppress(psutil.Error):
                words = process.cmdline()
                program = words[words.index("-m") + 1] if "-m" in words else ""
                if program in PROGRAMS:
                    yield (*PROGRAMS[program], process)
                elif program == "endpoints.environment" and process.environ().get("RCE_NAME") == self._environment:
                    yield "environment", f"metrics/{self._environment}", process

    def _tasks(self, path: str) -> float:
        found = _TASKS.search(self._metrics.json("GET", path).decode())
        return float(found[1]) if found else 0.0


def own_memory(pid: int) -> int:
    """Return the bytes of a process's pages that are not those of files: what it has allocated, in swap space too.

    The unique set size counts pages of programs and libraries as well, from the time on when no other process has them.
    """
    sizes = dict(_ROLLUP.findall(Path(f"/proc/{pid}/smaps_rollup").read_text()))
    return 1024 * sum(int(sizes[kind]) for kind in ("Anonymous", "Pss_Shmem", "Swap"))


def _size(path: Path) -> int:
    """Return the size of a file, 0 if it has just been removed."""
    try:
        return path.stat().st_size
    except OSError:
        return 0
