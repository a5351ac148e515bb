"""Localisation of a recording in a known map, and its errors."""

from __future__ import annotations

import itertools
import statistics
import time
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import wrap_angles
from rce.mapping.localiser import Localiser
from rce.mapping.scans import Scan


@dataclass(frozen=True, slots=True)
class Localisation:
    """Result of localising a recording.

    Attributes:
        scans: Number of scans.
        first: Index of the first scan whose pose was known; None if none was.
        losses: How often the robot was lost after it had been found.
        seconds: Median time of a scan of a robot that is tracked; None if there was none.
        trajectory: (n, 4) stamp, x, y, theta of the scans whose pose was known, map frame.
    """

    scans: int
    first: int | None
    losses: int
    seconds: float | None
    trajectory: NDArray[np.float64]


def localise(localiser: Localiser, scans: Iterable[Scan]) -> Localisation:
    """Localise scans, and measure how."""
    known: list[bool] = []
    times: list[float] = []
    for scan in scans:
        lost, began = localiser.lost, time.perf_counter()
        localiser.add(scan)
        if not lost:
            times.append(time.perf_counter() - began)
        known.append(not localiser.lost)
    losses = sum(before and not after for before, after in itertools.pairwise(known))
    first = known.index(True) if True in known else None
    return Localisation(len(known), first, losses, statistics.median(times) if times else None, localiser.trajectory())


def errors_of(trajectory: NDArray[np.float64], truth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the errors (n, 2) of a trajectory, metres and radians.

    Args:
        trajectory: (n, 4) stamp, x, y, theta.
        truth: (m, 4) the same of all scans, in the same frame; it has each stamp of the trajectory.
    """
    right = truth[np.searchsorted(truth[:, 0], trajectory[:, 0])]
    moved = np.hypot(*(trajectory[:, 1:3] - right[:, 1:3]).T)
    return np.stack([moved, np.abs(wrap_angles(trajectory[:, 3] - right[:, 3]))], axis=1)
