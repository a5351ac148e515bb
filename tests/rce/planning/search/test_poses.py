"""Collisions of poses, and the parts of Hybrid-A*; paths are tested in test_hybrid.py."""

from __future__ import annotations

import math

import numpy as np

from rce.mapping.geometry import Pose
from rce.planning.costmap import Costmap
from rce.planning.curves import kernels as curves
from rce.planning.footprint import Footprint
from rce.planning.hybrid import in_cells, world_of
from rce.planning.search.poses import curve_between, motion_of, path_cost, pose_cost
from tests.support.planning import ROBOT, grid_of

CORRIDOR = ["#" * 30, *[" " * 30] * 6, "#" * 30]
LONG = Footprint.polygon(((0.8, 0.2), (0.8, -0.2), (-0.8, -0.2), (-0.8, 0.2)))


def test_long_robot_fits_along_a_corridor_and_not_across_it() -> None:
    costmap = Costmap(grid_of(*CORRIDOR), LONG)
    world = world_of(costmap)
    assert pose_cost(*world, *in_cells(costmap, Pose(1.5, 0.4, 0.0))) >= 0
    assert pose_cost(*world, *in_cells(costmap, Pose(1.5, 0.4, math.pi / 2))) == -1
    assert pose_cost(*world, *in_cells(costmap, Pose(0.5, 0.4, 0.0))) == -1  # through the edge of the map


def test_circle_is_tested_by_its_centre() -> None:
    costmap = Costmap(grid_of(*CORRIDOR), ROBOT)
    world = world_of(costmap)
    assert pose_cost(*world, *in_cells(costmap, Pose(1.5, 0.45, 1.0))) >= 0
    assert pose_cost(*world, *in_cells(costmap, Pose(1.5, 0.15, 1.0))) == -1
    assert pose_cost(*world, *in_cells(costmap, Pose(-9.0, 0.15, 1.0))) == -1


def test_cost_of_a_path_is_that_of_no_collision() -> None:
    costmap = Costmap(grid_of(*CORRIDOR), ROBOT)
    world = world_of(costmap)
    free, hit = in_cells(costmap, Pose(1.5, 0.45, 0.0)), in_cells(costmap, Pose(1.5, 0.0, 0.0))
    assert path_cost(*world, np.array([free, free])) == pose_cost(*world, *free)
    assert path_cost(*world, np.array([free, hit])) == -1


def test_motions_are_three_kinds_forward_and_in_reverse() -> None:
    assert [motion_of(number) for number in range(6)] == [
        (kind, sign) for sign in (1.0, -1.0) for kind in (curves.RIGHT, curves.STRAIGHT, curves.LEFT)
    ]


def test_curve_between_poses_is_that_of_their_relative_pose() -> None:
    curve = curve_between(3.0, 4.0, 0.5, 3.0 + 6 * math.cos(0.5), 4.0 + 6 * math.sin(0.5), 0.5, 2.0, 0)
    assert math.isclose(float(np.abs(curve[:, 1]).sum()), 3.0, abs_tol=1e-9)
