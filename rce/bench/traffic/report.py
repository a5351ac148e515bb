"""Traffic as text and as JSON."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from msgspec import to_builtins

from rce.bench.report import MILLI, aligned, machine
from rce.bench.statistics import percentile
from rce.bench.traffic.crowd import Crowd
from rce.bench.traffic.flood import Flood


def as_text(crowds: Sequence[Crowd], floods: Sequence[Flood]) -> str:
    """Return tables of both."""
    host = machine()
    rows = [["robots", "processes", "kB each", "sent", "lost", "p50 ms", "p99 ms", "endpoint", "robots' cores"]]
    rows += [list(_crowd_row(each)) for each in crowds]
    table = [["bytes", "published a second", "received", "told dropped"]]
    table += [
        [f"{figure:.0f}" for figure in (each.size, each.published, each.received, each.dropped)] for each in floods
    ]
    title = f"Robots that send each other messages; {host['processor']}, {host['cores']} cores, load {host['load']:.1f}"
    return "\n".join([title, "", *aligned(rows), "", "A node that floods a robot", "", *aligned(table)])


def _crowd_row(each: Crowd) -> Iterator[str]:
    yield from (str(each.robots), str(each.processes), f"{each.memory / 1e3:.1f}", str(each.sent))
    yield str(each.sent - each.received)
    yield from (f"{percentile(each.latencies, percent) * MILLI:.1f}" for percent in (50, 99))
    yield from (f"{each.endpoint:.2f}", f"{each.bench:.2f}")


def as_data(crowds: Sequence[Crowd], floods: Sequence[Flood]) -> dict[str, Any]:
    """Return all samples, for JSON."""
    return {"machine": machine(), "crowds": to_builtins(crowds), "floods": to_builtins(floods)}
