"""Global localisation in the map of the first half of a recording: whether and how exactly a robot is found."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from rce.errors import InvalidRequest
from rce.mapping.evaluation.trials.localisation import errors_of, localise
from rce.mapping.files.recordings import open_recording
from rce.mapping.grid import OccupancyGrid
from rce.mapping.localiser import Localiser
from rce.mapping.pose_graph.mapper import GraphMapper
from rce.mapping.scans import Scan

WRONG = 0.5  # metres; a pose that is further off is wrong


class Figure(Struct):
    """Result of one start without an initial pose.

    Attributes:
        start: Index of the first scan in the recording.
        inside: Share of the scans at which the robot is in the mapped space.
        first: Scans until the robot was found; None if it was not.
        known: Share of the scans with a pose.
        wrong: Share of these poses that are more than half a metre off.
        metres: Median error of these poses; None without any.
        degrees: Median error of their heading.
        milliseconds: Median time of a scan while the robot is tracked.
    """

    start: int
    inside: float
    first: int | None
    known: float
    wrong: float | None
    metres: float | None
    degrees: float | None
    milliseconds: float | None


def measure(path: Path, parts: int, scans: int) -> list[Figure]:
    """Localise parts of the second half of a recording in the map of the first half.

    The truth is the trajectory by which the whole recording is mapped.

    Args:
        path: The recording.
        parts: Number of parts, evenly spread.
        scans: Length of each part.

    Raises:
        InvalidRequest: The recording has too few scans.
    """
    records = list(open_recording(path))
    middle = len(records) // 2
    if middle < max(parts, scans):
        raise InvalidRequest(f"{path.name} has {len(records)} scans, too few for {parts} parts of {scans} in its half")
    grid, truth = _mapped(records[:middle]).grid(), _mapped(records).trajectory()
    starts = [middle + i * (len(records) - scans - middle) // max(parts - 1, 1) for i in range(parts)]
    return [_figure(grid, start, records[start : start + scans], truth) for start in starts]


def table(figures: list[Figure]) -> str:
    """Return the figures as a table in Markdown."""
    rows = ["| start | inside | found after | known | wrong | error | time |", "|---|---|---|---|---|---|---|"]
    for each in figures:
        after = "not" if each.first is None else f"{each.first} scans"
        found = [f"{each.start}", f"{each.inside:.0%}", after, f"{each.known:.0%}"]
        if each.wrong is None or each.milliseconds is None:
            rows.append(f"| {' | '.join(found)} | | | |")
            continue
        error = f"{each.metres:.3f} m, {each.degrees:.2f}°"
        rows.append(f"| {' | '.join(found)} | {each.wrong:.0%} | {error} | {each.milliseconds:.1f} ms |")
    return "\n".join(rows)


def _mapped(records: Sequence[Scan]) -> GraphMapper:
    mapper = GraphMapper()
    for scan in records:
        mapper.add(scan)
    return mapper


def _figure(grid: OccupancyGrid, start: int, scans: Sequence[Scan], truth: NDArray[np.float64]) -> Figure:
    found = localise(Localiser(grid), scans)
    places = truth[np.searchsorted(truth[:, 0], [scan.stamp for scan in scans]), 1:3]
    inside = float(np.mean(grid.at(places) >= 0))
    share = len(found.trajectory) / len(scans)
    if found.first is None or found.seconds is None:
        return Figure(start, inside, None, share, None, None, None, None)
    errors = errors_of(found.trajectory, truth)
    metres, degrees = np.median(errors, axis=0).tolist()
    wrong = float(np.mean(errors[:, 0] > WRONG))
    return Figure(
        start, inside, found.first + 1, share, wrong, metres, float(np.degrees(degrees)), 1000 * found.seconds
    )
