from __future__ import annotations

import numpy as np

from rce.mapping3d.camera import Depth
from rce.mapping3d.dense.floor_plan import cut
from rce.mapping3d.poses import Pose, transform
from tests.support.rooms import round_trip


def views() -> list[tuple[Pose, Depth]]:
    return [(pose, each.camera.points(each.frame.depth).reshape(-1, 3)) for each, pose in round_trip()]


def test_walls_and_table_are_occupied_and_the_floor_is_free() -> None:
    surface = np.concatenate([transform(pose, points) for pose, points in views()]).astype(np.float32)
    grid = cut(surface, views(), 0.05, 1.2)
    places = np.array([[-2.0, 0.0], [0.0, 1.5], [0.9, 0.0], [-1.75, 0.5], [-0.5, -1.35], [0.5, 1.2]])
    assert grid.at(places).tolist() == [100, 100, 100, 0, 0, 0]


def test_what_is_higher_than_the_robot_is_no_obstacle() -> None:
    surface = np.concatenate([transform(pose, points) for pose, points in views()]).astype(np.float32)
    grid = cut(surface[surface[:, 2] > 0.65], views(), 0.05, 0.6)
    assert not (grid.cells == 100).any()


def test_ray_above_a_table_does_not_make_free_what_stands_behind() -> None:
    ray = np.array([[3.0, 0.0, 0.9]], np.float32)
    pose = np.eye(4)
    pose[:3, 3] = 0.0, 0.0, 1.3
    grid = cut(np.empty((0, 3), np.float32), [(pose, ray - [0, 0, 1.3])], 0.05, 1.2)
    assert (grid.cells == -1).all()


def test_plan_of_nothing_is_one_unknown_cell() -> None:
    assert cut(np.empty((0, 3), np.float32), [], 0.05, 1.2).cells.tolist() == [[-1]]
