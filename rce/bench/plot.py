"""Plot of round trips like figure 9 of the Rapyuta paper. Needs the extra `bench`."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
from matplotlib.figure import Figure

from rce.bench.statistics import Series

MILLI = 1e3


def plot(all_series: Sequence[Series], path: Path) -> None:
    """Plot medians over sizes on logarithmic axes: topics and services side by side, bare echoes in both.

    The suffix of `path` determines the format.
    """
    figure = Figure(figsize=(12, 5), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, transport, title in ((left, "topic", "(a) topics"), (right, "service", "(b) services")):
        for series in all_series:
            if series.transport in (transport, "floor"):
                sizes = sorted(series.seconds)
                medians = [statistics.median(series.seconds[size]) * MILLI for size in sizes]
                style = ":" if series.transport == "floor" else "-"
                axes.loglog(sizes, medians, style if len(sizes) > 1 else "", marker="o", ms=3, label=series.name)
        axes.set(title=title, xlabel="bytes", ylabel="round trip, ms")
        axes.grid(True, which="major", alpha=0.4)
        if axes.lines:
            axes.legend(fontsize="small")
    figure.savefig(path)
