"""Plots of `rce bench map` and `rce bench endless`. Needs the extra `bench`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import numpy as np
from matplotlib.figure import Figure

from rce.bench.maps import Results
from rce.bench.maps_report import baselines
from rce.mapping.evaluation.trials import Endless

HOUR = 3600 * 10  # scans at 10 Hz
MEGA, MILLI = 1e6, 1e3


def plot(results: Results, path: Path) -> None:
    """Plot times of upload and mapping (RoboWS, figure 3b), and the errors of maps and of other systems."""
    figure = Figure(figsize=(13, 5), layout="constrained")
    left, right = figure.subplots(1, 2)
    _times(left, results)
    _errors(right, results)
    figure.savefig(path, dpi=100)


def _times(axes: Any, results: Results) -> None:
    """Plot the times of the map service as bars."""
    names = [each.name for each in results.recordings]
    mappers = list(dict.fromkeys(each.mapper for each in results.served))
    width = 0.8 / (len(mappers) + 1)
    sent = {each.recording: each.transmission for each in reversed(results.served)}
    bars = {"transmission": sent} | {
        f"mapping, {mapper}": {each.recording: each.mapping for each in results.served if each.mapper == mapper}
        for mapper in mappers
    }
    for number, (label, seconds) in enumerate(bars.items()):
        places = np.arange(len(names)) + (number - len(mappers) / 2) * width
        axes.bar(places, [seconds.get(name, 0.0) for name in names], width, label=label)
    axes.set_xticks(range(len(names)), names, rotation=20, ha="right")
    axes.set(title="By the map service", ylabel="seconds", yscale="log" if results.served else "linear")
    axes.grid(True, axis="y", alpha=0.4)
    axes.legend(fontsize="small")


def _errors(axes: Any, results: Results) -> None:
    """Plot the errors of maps as bars, those of other systems in grey."""
    rows: list[tuple[str, float, str]] = []
    for each in results.mapped:
        kind = next((kind for kind in ("benchmark", "loop", "far") if kind in each.errors), "")
        if kind:
            label = f"{each.recording.partition('.')[0]}, {each.mapper}, {each.odometry} ({kind})"
            rows.append((label, each.errors[kind][0], "C0"))
    for recording in results.recordings:
        if recording.relations:
            rows += [(other.system, other.translation, "C7") for other in baselines(recording.name)]
    labels, errors, colours = zip(*reversed(rows), strict=True) if rows else ((), (), ())
    axes.barh(range(len(rows)), errors, color=colours)
    axes.set_yticks(range(len(rows)), labels, fontsize="small")
    axes.set(title="Mean error of relations between poses", xlabel="metres", xscale="log", xlim=(0.01, None))
    axes.grid(True, axis="x", alpha=0.4)


def plot_endless(runs: Mapping[str, Endless], path: Path) -> None:
    """Plot memory and time a scan over hours of scans."""
    figure = Figure(figsize=(12, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, each in runs.items():
        hours = each.scans / HOUR
        left.plot(hours, each.memory / MEGA, label=name)
        (line,) = right.plot(hours, each.seconds * MILLI, label=f"{name}, CPU, mean")
        right.plot(hours, each.longest * MILLI, ":", color=line.get_color(), label=f"{name}, longest")
    left.set(title="memory of the process", xlabel="hours at 10 Hz", ylabel="MB", ylim=(0, None))
    right.set(title="time a scan", xlabel="hours at 10 Hz", ylabel="ms", yscale="log")
    for axes in (left, right):
        axes.grid(True, alpha=0.4)
        axes.legend(fontsize="small")
    figure.savefig(path, dpi=100)
