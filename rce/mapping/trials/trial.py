"""One mapper on one recording, measured."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.grid import OccupancyGrid
from rce.mapping.mapper import Mapper
from rce.mapping.scans import Scan
from rce.mapping.trials.odometry import Odometry, with_odometry
from rce.mapping.trials.relations import Error, Relations, error_of, relations_of

CLOSED = 0.5  # metres; the mean error between two visits of a place, with which its walls are still single


@dataclass(frozen=True, slots=True)
class Trial:
    """What came of it. `cpu`: seconds of this process, of all its threads, without compiling. `errors` by the kind of
    relation (`relations_of`); `closed`: whether places that were visited again are where they were, None if there are
    none."""

    scans: int
    cpu: float
    errors: dict[str, Error]
    grid: OccupancyGrid
    trajectory: NDArray[np.float64]

    @property
    def closed(self) -> bool | None:
        loop = self.errors.get("loop")
        return None if loop is None or not loop.relations else loop.translation < CLOSED


def run(
    make: Callable[[], Mapper],
    scans: Iterable[Scan],
    odometry: Odometry | None = None,
    relations: dict[str, Relations] | None = None,
) -> Trial:
    """Map scans, with their odometry made worse if so wanted. Without `relations` the odometry of the scans is taken
    for the truth, as it is in corrected logs."""
    scans = list(scans)
    given = list(with_odometry(scans, odometry)) if odometry else scans
    mapper = make()
    before = time.process_time()
    for scan in given:
        mapper.add(scan)
    grid = mapper.grid()
    cpu = time.process_time() - before
    trajectory = mapper.trajectory()
    if relations is None:
        relations = relations_of(_truth(scans))
    errors = {kind: error_of(trajectory, each) for kind, each in relations.items()}
    return Trial(len(scans), cpu, errors, grid, trajectory)


def _truth(scans: list[Scan]) -> NDArray[np.float64]:
    known = [(scan.stamp, *scan.odometry) for scan in scans if scan.odometry is not None]
    if len(known) != len(scans):
        raise ValueError(f"only {len(known)} of {len(scans)} scans have a pose that could be the truth")
    return np.array(known).reshape(-1, 4)
