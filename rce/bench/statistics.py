"""Round trips as they are taken and what is said of them. Times in seconds."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence

from msgspec import Struct, field

SMALL = 10_000  # bytes up to which round-trip times hardly depend on the size (section V of the paper)
ENOUGH = 100  # samples from which a 99th percentile means something


class Series(Struct):
    """The round trips of one kind of message by one route; `beside` names the series that it is compared with."""

    name: str
    transport: str
    beside: str = ""
    seconds: dict[int, list[float]] = field(default_factory=dict)  # by size in bytes

    def add(self, size: int, seconds: float) -> None:
        self.seconds.setdefault(size, []).append(seconds)

    def small(self) -> list[float]:
        """All samples of messages up to 10 kB."""
        return [each for size, taken in self.seconds.items() if size <= SMALL for each in taken]


class Summary(Struct):
    """`p99` is None where there are too few samples; `ratio` is that of the medians, None where nothing is beside."""

    median: float
    p99: float | None
    ratio: float | None


def summary(taken: Sequence[float], beside: Sequence[float]) -> Summary | None:
    """None without samples."""
    if not taken:
        return None
    median = statistics.median(taken)
    tail = percentile(taken, 99) if len(taken) >= ENOUGH else None
    return Summary(median, tail, median / statistics.median(beside) if beside else None)


def percentile(taken: Iterable[float], percent: float) -> float:
    """The smallest sample that at least `percent` of all do not exceed (nearest rank)."""
    ordered = sorted(taken)
    return ordered[max(0, math.ceil(len(ordered) * percent / 100) - 1)]
