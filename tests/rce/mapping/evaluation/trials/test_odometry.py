"""Degraded odometry."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.evaluation.trials import (
    Odometry,
    with_odometry,
)
from rce.mapping.evaluation.trials.odometry import SLIP_TURN
from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.scans import Scan


def test_same_seed_degrades_odometry_alike(simulation: Simulation) -> None:
    scans = simulation.records[:100]

    def way(odometry: Odometry) -> float:
        poses = np.array([scan.odometry for scan in with_odometry(scans, odometry)])
        return float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())

    assert way(Odometry(scale=1.1)) == pytest.approx(1.1 * way(Odometry()))
    assert way(Odometry(slip=1.0, slip_every=50)) > way(Odometry()) + 0.9
    noisy = [[scan.odometry for scan in with_odometry(scans, Odometry(noise=0.1), seed)] for seed in (0, 0, 1)]
    assert noisy[0] == noisy[1] != noisy[2]
    assert {scan.odometry for scan in with_odometry(scans, Odometry(none=True))} == {None}


def driven(count: int) -> list[Scan]:
    """Return scans of a robot that has driven straight on, a metre a scan."""
    nothing = np.empty(0, np.float32)
    return [Scan(float(i), nothing, 0.0, 0.1, 10.0, Pose(5.0 + i, 2.0, 0.0)) for i in range(count)]


def test_odometry_begins_at_the_origin_and_keeps_its_motions() -> None:
    poses = [scan.odometry for scan in with_odometry(driven(3), Odometry())]
    assert poses == [ORIGIN, pytest.approx((1.0, 0.0, 0.0)), pytest.approx((2.0, 0.0, 0.0))]


def test_wheels_slip_every_so_many_scans() -> None:
    scans = with_odometry(driven(6), Odometry(slip=0.5, slip_every=3))
    turns = [scan.odometry.theta for scan in scans if scan.odometry]
    assert turns == pytest.approx([0.0, 0.0, SLIP_TURN, SLIP_TURN, SLIP_TURN, 2 * SLIP_TURN])


def test_scan_without_odometry_stays_without() -> None:
    scans = driven(3)
    scans[1] = dataclasses.replace(scans[1], odometry=None)
    poses = [scan.odometry for scan in with_odometry(scans, Odometry(noise=0.1))]
    assert [pose is None for pose in poses] == [False, True, False]
    assert poses[2] is not None
    assert poses[2].x == pytest.approx(2.0, abs=1.0), "the motion over the gap is not lost"
