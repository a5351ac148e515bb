"""Samples of round trips and their statistics. Times are in seconds."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence

from msgspec import Struct, field

SMALL = 10_000  # bytes up to which round-trip times hardly depend on the size (section V of the Rapyuta paper)
MIN_FOR_P99 = 100  # samples from which on a 99th percentile is meaningful


class Series(Struct):
    """Round trips of one kind of message by one route.

    Attributes:
        name: Name of the probe.
        transport: `topic`, `service` or `floor`.
        beside: Name of the series that it is compared with, or empty.
        seconds: Samples by size in bytes.
    """

    name: str
    transport: str
    beside: str = ""
    seconds: dict[int, list[float]] = field(default_factory=dict)

    def add(self, size: int, seconds: float) -> None:
        """Add a sample."""
        self.seconds.setdefault(size, []).append(seconds)

    def small(self) -> list[float]:
        """Return all samples of messages up to 10 kB."""
        return [each for size, taken in self.seconds.items() if size <= SMALL for each in taken]


class Summary(Struct):
    """Statistics of samples.

    Attributes:
        median: Median.
        p99: 99th percentile; None if there are too few samples.
        ratio: Ratio of the medians to those of the series compared with; None without one.
    """

    median: float
    p99: float | None
    ratio: float | None


def summary(taken: Sequence[float], beside: Sequence[float]) -> Summary | None:
    """Return the statistics of samples and their ratio to others; None without samples."""
    if not taken:
        return None
    median = statistics.median(taken)
    tail = percentile(taken, 99) if len(taken) >= MIN_FOR_P99 else None
    return Summary(median, tail, median / statistics.median(beside) if beside else None)


def percentile(taken: Iterable[float], percent: float) -> float:
    """Return the smallest sample that at least `percent` of all samples do not exceed (nearest rank)."""
    ordered = sorted(taken)
    return ordered[max(0, math.ceil(len(ordered) * percent / 100) - 1)]
