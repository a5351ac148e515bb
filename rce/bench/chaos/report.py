"""Result of a run, as text and as JSON."""

from __future__ import annotations

import statistics
from typing import Any

from msgspec import Struct, to_builtins

from rce.bench.chaos.flows import FlowCount
from rce.bench.report import aligned, machine
from rce.bench.statistics import percentile


class Result(Struct):
    """Result of a run.

    Attributes:
        seed: Seed of all random choices.
        seconds: Duration.
        events: Faults by kind and victim.
        acknowledged: Number of acknowledged commands.
        refused: Number of refused attempts, by the code of their error.
        audits: Seconds that each comparison took until everything agreed.
        recoveries: Seconds until a victim worked again, by kind and victim; of faults that were alone.
        flows: Messages.
        disks: Whether disks could be filled.
    """

    seed: int
    seconds: float
    events: dict[str, int]
    acknowledged: int
    refused: dict[str, int]
    audits: list[float]
    recoveries: dict[str, list[float]]
    flows: list[FlowCount]
    disks: bool


def as_text(result: Result) -> str:
    """Return the figures and the table of recovery times."""
    host = machine()
    flows = result.flows
    sent, lost = sum(each.sent for each in flows), sum(each.lost for each in flows)
    excused = sum(each.lost_in_faults for each in flows)
    lines = [
        f"{sum(result.events.values())} faults in {result.seconds:.0f} s, seed {result.seed}; "
        f"{host['processor']}, {host['cores']} cores, load {host['load']:.1f}",
        f"{result.acknowledged} commands acknowledged, all present in {len(result.audits)} comparisons; refused and "
        f"repeated: {_counts(result.refused)}",
        f"{sent} messages sent, {sum(each.received for each in flows)} arrived, "
        f"{sum(each.duplicates for each in flows)} twice, {sum(each.reordered for each in flows)} out of order; "
        f"lost at a process that was killed: {excused}, otherwise: {lost}",
    ]
    if not result.disks:
        lines.append("no disk was full: only root may mount the file systems for that")
    rows = [["fault", "number", "recovery: p50", "max"]]
    for label, taken in sorted(result.recoveries.items()):
        rows.append([label, str(result.events[label]), *(f"{each:.2f} s" for each in _figures(taken))])
    return "\n".join([*lines, "", *aligned(rows)])


def _counts(numbers: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in sorted(numbers.items())) or "none"


def _figures(taken: list[float]) -> tuple[float, float]:
    return statistics.median(taken), percentile(taken, 100)


def as_data(result: Result) -> dict[str, Any]:
    """Return everything for JSON."""
    data: dict[str, Any] = to_builtins({"machine": machine(), "chaos": result})
    return data
