"""Result of a run, as text and as JSON."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
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
        events: Faults by victim and kind.
        acknowledged: Number of acknowledged commands of robots.
        refused: Number of refused attempts, by the code of their error.
        writes: Number of writes over HTTP that a Master acknowledged.
        terms: Number of terms.
        take_overs: Seconds from a fault that deposed the leader until the other Master led.
        commands: Seconds from the begin of a fault until a robot's command was acknowledged, by victim and kind.
        audits: Seconds that each comparison took until everything agreed.
        flows: Messages.
        gap: Longest time in seconds in which a flow delivered no message.
        clocks: Whether clocks could jump.
    """

    seed: int
    seconds: float
    events: dict[str, int]
    acknowledged: int
    refused: dict[str, int]
    writes: int
    terms: int
    take_overs: list[float]
    commands: dict[str, list[float]]
    audits: list[float]
    flows: list[FlowCount]
    gap: float
    clocks: bool


def as_text(result: Result) -> str:
    """Return the figures and the table of times."""
    host, flows = machine(), result.flows
    refused = ", ".join(f"{name} {count}" for name, count in sorted(result.refused.items())) or "none"
    lines = [
        f"{sum(result.events.values())} faults in {result.seconds:.0f} s, seed {result.seed}, {result.terms} terms; "
        f"{host['processor']}, {host['cores']} cores, load {host['load']:.1f}",
        f"{result.acknowledged} commands acknowledged, all present in {len(result.audits)} comparisons; refused and "
        f"repeated: {refused}",
        f"{result.writes} writes over HTTP acknowledged, none by a Master in the term of another one",
        f"{sum(each.sent for each in flows)} messages sent, {sum(each.received for each in flows)} arrived, "
        f"{sum(each.lost for each in flows)} lost; longest gap {result.gap:.2f} s",
        f"take-over: {len(result.take_overs)} times, {_figures(result.take_overs)}",
    ]
    if not result.clocks:
        lines.append("no clock jumped: there is no C compiler")
    rows = [["fault", "number", "until a command is acknowledged: p50, max"]]
    for label, taken in sorted(result.commands.items()):
        rows.append([label, str(result.events[label]), _figures(taken)])
    return "\n".join([*lines, "", *aligned(rows)])


def _figures(taken: Sequence[float]) -> str:
    return f"{statistics.median(taken):.2f} s, {percentile(list(taken), 100):.2f} s" if taken else "-"


def as_data(result: Result) -> dict[str, Any]:
    """Return everything for JSON."""
    data: dict[str, Any] = to_builtins({"machine": machine(), "standby": result})
    return data
