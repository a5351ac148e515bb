"""Round trips as text and as JSON."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from rce.bench.statistics import Series, Summary, summary

MILLI = 1e3
GROUPS = {"floor": "bare echoes", "topic": "topics", "service": "services"}


def machine() -> dict[str, Any]:
    """Return processor, cores, load and Python version: the conditions of a measurement."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "unknown")
    return {
        "processor": model,
        "cores": len(os.sched_getaffinity(0)),
        "load": os.getloadavg()[0],
        "python": platform.python_version(),
    }


def as_data(all_series: Sequence[Series]) -> dict[str, Any]:
    """Return all samples in seconds, by series and size, for JSON."""
    data: dict[str, Any] = msgspec.to_builtins({"machine": machine(), "series": all_series}, str_keys=True)
    return data


def as_text(all_series: Sequence[Series]) -> str:
    """Return tables of medians in milliseconds with their ratio to the series that they are compared with.

    The last rows summarise all sizes up to 10 kB.
    """
    host = machine()
    lines = [
        f"Round trips, medians in ms (ratio to those between nodes); {host['processor']}, {host['cores']} cores, "
        f"load {host['load']:.1f}, Python {host['python']}"
    ]
    by_name = {series.name: series for series in all_series}
    for transport, title in GROUPS.items():
        group = [series for series in all_series if series.transport == transport]
        if group:
            lines += ["", title, *_table(group, by_name)]
    return "\n".join(lines)


def _table(group: Sequence[Series], by_name: Mapping[str, Series]) -> list[str]:
    sizes = sorted({size for series in group for size in series.seconds})
    rows = [["bytes", *(series.name for series in group)]]
    rows += [[f"{size:,}", *(_cell(_at(series, size, by_name)) for series in group)] for size in sizes]
    small = [_small(series, by_name) for series in group]
    rows.append(["up to 10 kB", *(_cell(each) for each in small)])
    rows.append(["p99 of these", *(_tail(each) for each in small)])
    return list(aligned(rows))


def _at(series: Series, size: int, by_name: Mapping[str, Series]) -> Summary | None:
    beside = by_name.get(series.beside)
    return summary(series.seconds.get(size, []), beside.seconds.get(size, []) if beside else [])


def _small(series: Series, by_name: Mapping[str, Series]) -> Summary | None:
    beside = by_name.get(series.beside)
    return summary(series.small(), beside.small() if beside else [])


def _cell(found: Summary | None) -> str:
    if found is None:
        return ""
    ratio = f" ({found.ratio:.1f})" if found.ratio is not None else ""
    return f"{found.median * MILLI:.2f}{ratio}"


def _tail(found: Summary | None) -> str:
    return f"{found.p99 * MILLI:.2f}" if found is not None and found.p99 is not None else ""


def aligned(rows: Iterable[Sequence[str]]) -> Iterable[str]:
    """Return rows as lines with right-aligned columns, each as wide as its widest cell."""
    rows = list(rows)
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    return ("  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows)
