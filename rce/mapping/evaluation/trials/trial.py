"""Trial of one mapper on one recording."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.evaluation.trials.odometry import Odometry, with_odometry
from rce.mapping.evaluation.trials.relations import Error, Relations, error_of, relations_of
from rce.mapping.grid import OccupancyGrid
from rce.mapping.mapper import Mapper
from rce.mapping.scans import Scan

MAX_LOOP_ERROR = 0.5  # metres; mean error between two visits of a place at which its walls are still single


@dataclass(frozen=True, slots=True)
class Trial:
    """Result of a trial.

    Attributes:
        scans: Number of scans.
        cpu: CPU seconds of all threads of this process, without compiling.
        errors: Error by kind of relation, see `relations_of`.
        grid: The map.
        trajectory: (n, 4) stamp, x, y, theta of each scan, map frame.
    """

    scans: int
    cpu: float
    errors: dict[str, Error]
    grid: OccupancyGrid
    trajectory: NDArray[np.float64]

    @property
    def closed(self) -> bool | None:
        """True if places that were visited twice coincide in the map; None if there are none."""
        loop = self.errors.get("loop")
        return None if loop is None or not loop.relations else loop.translation < MAX_LOOP_ERROR


def run(
    make: Callable[[], Mapper],
    scans: Iterable[Scan],
    odometry: Odometry | None = None,
    relations: dict[str, Relations] | None = None,
) -> Trial:
    """Map scans and measure the result.

    Args:
        make: Returns the mapper.
        scans: The scans.
        odometry: Errors to add to the odometry; None for none.
        relations: True relations by kind; None to take the odometry of the scans as the truth, as in corrected logs.

    Raises:
        ValueError: There are no relations, and a scan has no odometry.
    """
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
        raise ValueError(f"{len(known)} of {len(scans)} scans have odometry; as the truth it is needed for all")
    return np.array(known).reshape(-1, 4)
