"""Odometry made worse, to see what a mapper makes of it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.scans import Scan

DRIFT = 0.2  # radians a metre, for each 1 of noise
SLIP_TURN = 0.2  # radians, with every slip


@dataclass(frozen=True, slots=True)
class Odometry:
    """What wheels make of a motion: its distances `scale` times as long, each motion off by a share of about `noise`
    (and turned by 0.2 radians a metre times that), and after every `slip_every` scans the robot is `slip` metres beside
    where they say. `none`: there are no wheels."""

    scale: float = 1.0
    noise: float = 0.0
    slip: float = 0.0
    slip_every: int = 400
    none: bool = False


def with_odometry(scans: Iterable[Scan], odometry: Odometry, seed: int = 0) -> Iterator[Scan]:
    """The same scans, with the odometry that they have made worse. The same for the same seed."""
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
