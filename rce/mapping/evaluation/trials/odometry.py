"""Degraded odometry, to test the robustness of mappers."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.scans import Scan

DRIFT = 0.2  # radians a metre for a noise of 1
SLIP_TURN = 0.2  # radians of each slip


@dataclass(frozen=True, slots=True)
class Odometry:
    """Errors that are added to odometry.

    Attributes:
        scale: Factor of distances.
        noise: Standard deviation of each motion as a share of it; the heading drifts by 0.2 radians a metre times this.
        slip: Metres by which the wheels slip, with a turn of 0.2 radians.
        slip_every: Scans from one slip to the next.
        none: Whether odometry is removed.
    """

    scale: float = 1.0
    noise: float = 0.0
    slip: float = 0.0
    slip_every: int = 400
    none: bool = False


def with_odometry(scans: Iterable[Scan], odometry: Odometry, seed: int = 0) -> Iterator[Scan]:
    """Yield scans with degraded odometry. The same seed gives the same odometry."""
    random, last, pose = np.random.default_rng(seed), None, ORIGIN
    for i, scan in enumerate(scans):
        if odometry.none or scan.odometry is None:
            yield dataclasses.replace(scan, odometry=None)
            continue
        motion = (last or scan.odometry).to(scan.odometry)
        along, across, turn = 1 + odometry.noise * random.normal(size=3)
        drift = odometry.noise * DRIFT * math.hypot(motion.x, motion.y) * random.normal()
        pose = pose @ Pose(
            motion.x * along * odometry.scale, motion.y * across * odometry.scale, motion.theta * turn + drift
        )
        if odometry.slip and i % odometry.slip_every == odometry.slip_every - 1:
            pose = pose @ Pose(odometry.slip, 0.0, SLIP_TURN)
        last = scan.odometry
        yield dataclasses.replace(scan, odometry=pose)
