"""A recording forward, then back, then forward again: as long as one wants, and poses never jump."""

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
SAMPLES = 100  # of memory and time


@dataclass(frozen=True, slots=True)
class Endless:
    """One row for every hundredth part of the run: `scans` so far, `seconds` of CPU a scan (mean), the `longest` scan
    in seconds, `memory` of the process in bytes."""

    scans: NDArray[np.int64]
    seconds: NDArray[np.float64]
    longest: NDArray[np.float64]
    memory: NDArray[np.int64]


def to_and_fro(scans: Sequence[Scan], count: int) -> Iterator[Scan]:
    """`count` scans at 10 Hz."""
    there = list(range(len(scans)))
    around = there + there[-2:0:-1]
    for i in range(count):
        yield dataclasses.replace(scans[around[i % len(around)]], stamp=i / RATE)


def endless(make: Callable[[], Mapper], scans: Sequence[Scan], count: int = 36_000) -> Endless:
    """Map `count` scans and measure; 36,000 are an hour."""
    mapper, rows = make(), []
    piece = max(1, count // SAMPLES)
    longest, began = 0.0, time.process_time()
    for number, scan in enumerate(to_and_fro(scans, count), start=1):
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
    """How many times the mean of the second quarter the mean of the last one is; about 1 for what does not grow."""
    quarter = len(values) // 4
    return float(values[-quarter:].mean() / values[quarter : 2 * quarter].mean())


def resident() -> int:
    """Bytes of memory of this process. Linux."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096
