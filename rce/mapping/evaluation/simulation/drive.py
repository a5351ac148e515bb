"""Simulated robot: its motion, wheel odometry and laser."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.evaluation.simulation.floor_plan import ROUTE, FloorPlan, apartment
from rce.mapping.geometry import ORIGIN, Points, Pose, wrap_angle
from rce.mapping.scans import Scan


@dataclass(frozen=True, slots=True)
class RobotSettings:
    """Settings of the simulated robot.

    Attributes:
        period: Seconds between scans.
        speed: Metres per second at most.
        turn_rate: Radians per second at most.
        reached: Metres from a waypoint at which the robot heads for the next one.
        start: Stamp of the first scan, seconds.
        beams: Number of beams of a scan.
        field_of_view: Radians.
        range_max: Metres.
        range_noise: Metres; standard deviation of a range.
        stretch: Share by which odometry overestimates distances.
        drift: Radians by which odometry turns too much for each metre.
        step_noise: Standard deviation of the length of a step, as a share of it.
        turn_noise: Standard deviation of the turn of a step, as a share of it.
        seen_cell: Metres to which the points of walls that the laser saw are rounded.
    """

    period: float = 0.1
    speed: float = 1.0
    turn_rate: float = 1.6
    reached: float = 0.25
    start: float = 1.7e9
    beams: int = 360
    field_of_view: float = 2 * math.pi
    range_max: float = 12.0
    range_noise: float = 0.01
    stretch: float = 0.03
    drift: float = 0.02
    step_noise: float = 0.05
    turn_noise: float = 0.05
    seen_cell: float = 0.05


ROBOT = RobotSettings()


@dataclass(frozen=True, slots=True)
class Simulation:
    """Simulated recording (see `recordings.Recording`) with its ground truth.

    Attributes:
        name: Name of the recording.
        plan: Floor plan of the building.
        records: The scans.
        truth: (n, 4) stamp, x, y, theta of each scan, frame of the building.
        seen: (m, 2) points of walls at which beams ended, metres, frame of the building.
    """

    name: str
    plan: FloorPlan
    records: list[Scan]
    truth: NDArray[np.float64]
    seen: Points

    @property
    def scans(self) -> int:
        """Number of scans."""
        return len(self.records)

    @property
    def duration(self) -> float:
        """Seconds from the first scan to the last."""
        return float(self.truth[-1, 0] - self.truth[0, 0])

    def __iter__(self) -> Iterator[Scan]:
        """Yield the scans."""
        return iter(self.records)


def simulate(seed: int = 0, route: Sequence[tuple[float, float]] = ROUTE) -> Simulation:
    """Simulate a drive through all rooms of an apartment: about 90 m in 2 minutes, 10 scans of 360 beams a second.

    The same seed gives the same recording. Ranges have a noise of 1 cm; the odometry has noise and drifts.
    """
    random, plan = np.random.default_rng(seed), apartment()
    poses = drive(route)
    odometry = _wheels(poses, random)
    records, ends = [], []
    for i, (pose, wheels) in enumerate(zip(poses, odometry, strict=True)):
        exact = plan.ranges(*pose, ROBOT.beams, ROBOT.field_of_view)
        seen = np.flatnonzero(exact < ROBOT.range_max)
        ranges = np.full(ROBOT.beams, np.inf, np.float32)
        ranges[seen] = exact[seen] + random.normal(0.0, ROBOT.range_noise, len(seen))
        increment = ROBOT.field_of_view / ROBOT.beams
        scan = Scan(
            ROBOT.start + i * ROBOT.period, ranges, -ROBOT.field_of_view / 2, increment, ROBOT.range_max, wheels
        )
        records.append(scan)
        angles = pose.theta + scan.angle_min + increment * seen
        ends.append(np.stack([np.cos(angles), np.sin(angles)], axis=1) * exact[seen, None] + np.array(pose[:2]))
    truth = np.array([(scan.stamp, *pose) for scan, pose in zip(records, poses, strict=True)])
    points: Points = np.unique(np.rint(np.concatenate(ends) / ROBOT.seen_cell), axis=0) * ROBOT.seen_cell
    return Simulation("simulated apartment", plan, records, truth, points)


def drive(route: Sequence[tuple[float, float]]) -> list[Pose]:
    """Return the poses, one each period, of a robot that heads for one waypoint (metres) after the other."""
    (x, y), *targets = route
    pose = Pose(x, y, math.atan2(targets[0][1] - y, targets[0][0] - x))
    poses = [pose]
    for target in targets:
        while math.dist(pose[:2], target) > ROBOT.reached:
            error = wrap_angle(math.atan2(target[1] - pose.y, target[0] - pose.x) - pose.theta)
            turn = min(max(error, -ROBOT.turn_rate * ROBOT.period), ROBOT.turn_rate * ROBOT.period)
            pose = pose @ Pose(ROBOT.speed * ROBOT.period * max(math.cos(error), 0.0) ** 2, 0.0, turn)
            poses.append(pose)
    return poses


def _wheels(poses: list[Pose], random: np.random.Generator) -> list[Pose]:
    """Return the odometry of a drive; it starts at the origin of its own frame."""
    odometry = [ORIGIN]
    for before, after in itertools.pairwise(poses):
        motion = before.to(after)
        length, (a, b) = motion.x, random.normal(size=2).tolist()
        turn = motion.theta * (1 + ROBOT.turn_noise * b) + ROBOT.drift * length
        odometry.append(odometry[-1] @ Pose(length * (1 + ROBOT.stretch + ROBOT.step_noise * a), motion.y, turn))
    return odometry
