"""Result of the benchmark of bad networks as a table and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from msgspec import to_builtins

from rce.bench.network.run import Result
from rce.bench.network.streams import PERIODS, Arrivals
from rce.bench.report import MILLI, aligned, machine
from rce.bench.statistics import percentile

HEADER = ["profile", "mode", "stream", "delivered", "p50 ms", "p99 ms", "recovery s"]


def as_text(results: Sequence[Result]) -> str:
    """Return a table: what was delivered, its age, and the time from the end of each outage to the first message."""
    host = machine()
    title = f"Bad networks; {host['processor']}, {host['cores']} cores, load {host['load']:.1f}"
    rows = [HEADER, *(row for result in results for row in _rows(result))]
    return "\n".join([title, "", *aligned(rows)])


def _rows(result: Result) -> list[list[str]]:
    return [
        [result.profile, result.mode, name, *_figures(result.streams[name], result.seconds / period, result.ended)]
        for name, period in PERIODS.items()
    ]


def _figures(arrivals: Arrivals, made: float, ended: Sequence[float]) -> list[str]:
    share = f"{100 * len(arrivals.times) / made:.0f} %"
    ages = sorted(arrived - sent for sent, arrived in arrivals.times)
    if not ages:
        return [share, "-", "-", "-"]
    times = [f"{percentile(ages, share) * MILLI:.0f}" for share in (50, 99)]
    return [share, *times, ", ".join(_recoveries(arrivals, ended)) or "-"]


def _recoveries(arrivals: Arrivals, ended: Sequence[float]) -> list[str]:
    """Return the seconds from each end of an outage to the arrival of a message that was sent after it."""
    found = []
    for end in ended:
        first = min((arrived for sent, arrived in arrivals.times if sent >= end), default=None)
        found.append("never" if first is None else f"{first - end:.2f}")
    return found


def as_data(results: Sequence[Result]) -> dict[str, Any]:
    """Return all samples, for JSON."""
    return {"machine": machine(), "results": [to_builtins(result) for result in results]}
