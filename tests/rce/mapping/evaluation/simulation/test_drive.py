"""Simulated robot: its motion, odometry and laser."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from rce.mapping.evaluation.simulation import Simulation, simulate
from rce.mapping.evaluation.simulation.drive import ROBOT, drive
from rce.mapping.evaluation.simulation.floor_plan import LOWER_WALLS, UPPER_WALLS, WIDTH
from rce.mapping.geometry import Pose


def test_drive_takes_one_to_two_minutes_and_visits_all_rooms(simulation: Simulation) -> None:
    assert 60 < simulation.duration < 120
    assert simulation.scans == len(list(simulation)) == len(simulation.truth)
    for walls, inside in ((LOWER_WALLS, simulation.truth[:, 2] < 4), (UPPER_WALLS, simulation.truth[:, 2] > 7)):
        for left, right in zip((0.0, *walls), (*walls, WIDTH), strict=True):
            x = simulation.truth[inside, 1]
            assert ((x > left) & (x < right)).any()


def test_robot_keeps_clear_of_walls(simulation: Simulation) -> None:
    assert simulation.plan.distance(simulation.truth[:, 1:3]).min() > 0.2


def test_beams_end_on_walls(simulation: Simulation) -> None:
    for i in range(0, simulation.scans, 97):
        ends = Pose(*simulation.truth[i, 1:]).transform(simulation.records[i].points(100.0))
        assert simulation.plan.distance(ends).max() < 0.06


def test_odometry_drift_is_bounded(simulation: Simulation) -> None:
    wheels, truth = simulation.records[-1].odometry, simulation.truth
    assert wheels
    end = Pose(*truth[0, 1:]).to(Pose(*truth[-1, 1:]))
    assert 0.5 < math.dist(wheels[:2], end[:2]) < 15


@pytest.mark.slow
def test_seed_determines_the_simulation(simulation: Simulation) -> None:
    again, other = simulate(0), simulate(1)
    np.testing.assert_array_equal(again.records[100].ranges, simulation.records[100].ranges)
    assert again.records[-1].odometry == simulation.records[-1].odometry
    assert other.records[-1].odometry != simulation.records[-1].odometry


def test_robot_reaches_its_waypoints_within_its_limits() -> None:
    route = [(0.0, 0.0), (3.0, 0.0), (3.0, 2.0)]
    poses = drive(route)
    assert poses[0] == (0.0, 0.0, 0.0), "it starts at the first waypoint, headed for the second"
    for target in route[1:]:
        assert min(math.dist(pose[:2], target) for pose in poses) <= ROBOT.reached
    for before, after in itertools.pairwise(poses):
        step = before.to(after)
        assert math.hypot(step.x, step.y) <= ROBOT.speed * ROBOT.period + 1e-9
        assert abs(step.theta) <= ROBOT.turn_rate * ROBOT.period + 1e-9


def test_robot_turns_on_the_spot_towards_a_waypoint_behind_it() -> None:
    poses = drive([(0.0, 0.0), (2.0, 0.0), (-2.0, 0.0)])
    assert max(abs(pose.y) for pose in poses) < 0.3


def test_short_route_is_simulated_on_request() -> None:
    short = simulate(route=[(1.0, 5.5), (2.5, 5.5)])
    assert 1.0 < short.duration < 2.0
    assert {scan.range_max for scan in short} == {ROBOT.range_max}
    assert np.diff([scan.stamp for scan in short]) == pytest.approx(ROBOT.period, abs=1e-5)
    assert short.records[0].odometry == (0.0, 0.0, 0.0), "odometry has a frame of its own"
