"""Endless run: a recording forward, backward, forward ..., in which poses never jump."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rce.mapping.mapper import Mapper
from rce.mapping.scans import Scan

RATE = 10.0  # scans a second
SAMPLES = 100  # measurements of memory and time in a run


@dataclass(frozen=True, slots=True)
class Endless:
    """Measurements of an endless run, one for each hundredth of it.

    Attributes:
        scans: (n,) number of scans so far.
        seconds: (n,) mean CPU seconds a scan.
        longest: (n,) elapsed seconds of the longest scan.
        memory: (n,) resident memory of the process, bytes.
    """

    scans: NDArray[np.int64]
    seconds: NDArray[np.float64]
    longest: NDArray[np.float64]
    memory: NDArray[np.int64]


def back_and_forth(scans: Sequence[Scan], count: int) -> Iterator[Scan]:
    """Yield `count` scans of a recording, forward and backward, at 10 Hz."""
    there = list(range(len(scans)))
    around = there + there[-2:0:-1]
    for i in range(count):
        yield dataclasses.replace(scans[around[i % len(around)]], stamp=i / RATE)


def endless(make: Callable[[], Mapper], scans: Sequence[Scan], count: int = 36_000) -> Endless:
    """Map `count` scans and measure time and memory; 36,000 scans are an hour."""
    mapper, rows = make(), []
    piece = max(1, count // SAMPLES)
    longest, began = 0.0, time.process_time()
    for number, scan in enumerate(back_and_forth(scans, count), start=1):
        before = time.perf_counter()
        mapper.add(scan)
        longest = max(longest, time.perf_counter() - before)
        if number % piece == 0:
            spent = time.process_time() - began
            rows.append((number, spent / piece, longest, resident()))
            longest, began = 0.0, time.process_time()
    numbers, seconds, worst, memory = zip(*rows, strict=True)
    return Endless(np.array(numbers), np.array(seconds), np.array(worst), np.array(memory))


def flatness(values: NDArray[np.float64] | NDArray[np.int64]) -> float:
    """Return the mean of the last quarter divided by that of the second; about 1 for values that do not grow."""
    quarter = len(values) // 4
    return float(values[-quarter:].mean() / values[quarter : 2 * quarter].mean())


def resident() -> int:
    """Return the resident memory of this process in bytes (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096
