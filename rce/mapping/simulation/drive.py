"""The simulated robot: its drive, its wheels and its laser."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import ORIGIN, Points, Pose, wrap_angle
from rce.mapping.scans import Scan
from rce.mapping.simulation.floor_plan import ROUTE, FloorPlan, apartment

PERIOD = 0.1  # seconds between scans
SPEED, TURN_RATE = 1.0, 1.6  # metres and radians per second, at most
REACHED = 0.25  # metres from a waypoint
START = 1.7e9  # seconds; the stamp of the first scan
BEAMS, FIELD_OF_VIEW, RANGE_MAX, RANGE_NOISE = 360, 2 * math.pi, 12.0, 0.01
# Odometry: what it says too much of each metre, turns for each metre (drift), and the noise of both.
STRETCH, DRIFT, STEP_NOISE, TURN_NOISE = 0.03, 0.02, 0.05, 0.05
SEEN_CELL = 0.05  # metres; to this the wall points that the laser saw are rounded


@dataclass(frozen=True, slots=True)
class Simulation:
    """A recording (see `recordings.Recording`) with its truth.

    `truth`: (n, 4) stamp, x, y, theta of each scan, frame of the building; `seen`: (m, 2) points of the walls where
    beams ended, metres, same frame.
    """

    name: str
    plan: FloorPlan
    records: list[Scan]
    truth: NDArray[np.float64]
    seen: Points

    @property
    def scans(self) -> int:
        return len(self.records)

    @property
    def duration(self) -> float:
        return float(self.truth[-1, 0] - self.truth[0, 0])

    def __iter__(self) -> Iterator[Scan]:
        return iter(self.records)


def simulate(seed: int = 0, route: Sequence[tuple[float, float]] = ROUTE) -> Simulation:
    """Drive through all rooms of an apartment, about 90 m in 2 minutes, 10 scans of 360 beams a second.

    The same seed gives the same recording. Ranges have a noise of 1 cm; the odometry has noise and drifts.
    """
    random, plan = np.random.default_rng(seed), apartment()
    poses = drive(route)
    odometry = _wheels(poses, random)
    records, ends = [], []
    for i, (pose, wheels) in enumerate(zip(poses, odometry, strict=True)):
        exact = plan.ranges(*pose, BEAMS, FIELD_OF_VIEW)
        seen = np.flatnonzero(exact < RANGE_MAX)
        ranges = np.full(BEAMS, np.inf, np.float32)
        ranges[seen] = exact[seen] + random.normal(0.0, RANGE_NOISE, len(seen))
        increment = FIELD_OF_VIEW / BEAMS
        scan = Scan(START + i * PERIOD, ranges, -FIELD_OF_VIEW / 2, increment, RANGE_MAX, wheels)
        records.append(scan)
        angles = pose.theta + scan.angle_min + increment * seen
        ends.append(np.stack([np.cos(angles), np.sin(angles)], axis=1) * exact[seen, None] + np.array(pose[:2]))
    truth = np.array([(scan.stamp, *pose) for scan, pose in zip(records, poses, strict=True)])
    points: Points = np.unique(np.rint(np.concatenate(ends) / SEEN_CELL), axis=0) * SEEN_CELL
    return Simulation("simulated apartment", plan, records, truth, points)


def drive(route: Sequence[tuple[float, float]]) -> list[Pose]:
    """The poses, PERIOD apart, of a robot that heads for one waypoint (metres) after the other."""
    (x, y), *targets = route
    pose = Pose(x, y, math.atan2(targets[0][1] - y, targets[0][0] - x))
    poses = [pose]
    for target in targets:
        while math.dist(pose[:2], target) > REACHED:
            error = wrap_angle(math.atan2(target[1] - pose.y, target[0] - pose.x) - pose.theta)
            turn = min(max(error, -TURN_RATE * PERIOD), TURN_RATE * PERIOD)
            pose = pose @ Pose(SPEED * PERIOD * max(math.cos(error), 0.0) ** 2, 0.0, turn)
            poses.append(pose)
    return poses


def _wheels(poses: list[Pose], random: np.random.Generator) -> list[Pose]:
    """What odometry says of the drive; it starts at the origin of its own frame."""
    odometry = [ORIGIN]
    for before, after in itertools.pairwise(poses):
        motion = before.to(after)
        length, (a, b) = motion.x, random.normal(size=2).tolist()
        turn = motion.theta * (1 + TURN_NOISE * b) + DRIFT * length
        odometry.append(odometry[-1] @ Pose(length * (1 + STRETCH + STEP_NOISE * a), motion.y, turn))
    return odometry
