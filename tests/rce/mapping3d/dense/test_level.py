from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from rce.mapping3d.dense.level import find_floor, find_level, find_up
from rce.mapping3d.dense.mesh import Cloud
from rce.mapping3d.poses import Pose, inverse, make_pose, transform
from tests.support.rooms import looking, round_trip


def seen(tilt: Pose) -> tuple[Cloud, list[Pose]]:
    """Return the points of the room and the poses of the camera, all moved by `tilt`."""
    points, normals = [], []
    for key_frame, pose in round_trip():
        grid = key_frame.camera.points(key_frame.frame.depth).astype(np.float64)
        grid = transform(pose, grid.reshape(-1, 3)).reshape(grid.shape)[::3, ::3]
        normal = np.cross(grid[1:, :-1] - grid[:-1, :-1], grid[:-1, 1:] - grid[:-1, :-1])
        points.append(grid[:-1, :-1].reshape(-1, 3))
        normals.append(normal.reshape(-1, 3) / np.linalg.norm(normal, axis=2).reshape(-1, 1))
    poses = [tilt @ pose for _, pose in round_trip()]
    everything = transform(tilt, np.concatenate(points)).astype(np.float32)
    turned = (np.concatenate(normals) @ tilt[:3, :3].T).astype(np.float32)
    return Cloud(everything, turned, np.zeros(everything.shape, np.uint8)), poses


TILT = make_pose(Rotation.from_euler("xyz", [17, -12, 40], degrees=True).as_matrix(), [1.0, 2.0, -3.0])


def test_gravity_and_floor_of_a_tilted_map_are_found() -> None:
    cloud, poses = seen(TILT)
    level = find_level(cloud, poses)
    expected = inverse(TILT)
    assert np.degrees(np.arccos(level[2, :3] @ expected[2, :3])) < 0.3
    first = (level @ poses[0])[:3, 3]
    assert np.abs(first - [0.0, 0.0, 1.3]).max() < 0.02


def test_first_view_is_along_the_x_axis() -> None:
    cloud, poses = seen(TILT)
    ahead = (find_level(cloud, poses) @ poses[0])[:3, 2]
    assert abs(ahead[1]) < 1e-9
    assert ahead[0] > 0.8


def test_camera_that_looks_down_has_its_upper_edge_ahead() -> None:
    nothing = Cloud(np.empty((0, 3), np.float32), np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8))
    level = find_level(nothing, [looking(0, 0, 1, 0, 89.99), looking(0, 0, 1, 0, 0)])
    assert np.isfinite(level).all()


def test_without_surfaces_up_is_the_guess() -> None:
    assert find_up(np.zeros((0, 3)), np.array([0.0, -2.0, 0.0])).tolist() == [0.0, -1.0, 0.0]


def test_floor_is_the_lowest_large_surface_and_not_noise_below_it() -> None:
    heights = np.concatenate([np.full(500, 0.0), np.full(2000, 0.7), np.full(5, -0.4)])
    points = np.stack([np.zeros_like(heights), np.zeros_like(heights), heights], axis=1).astype(np.float32)
    normals = np.tile(np.array([0, 0, 1], np.float32), (len(points), 1))
    cloud = Cloud(points, normals, np.zeros(points.shape, np.uint8))
    assert abs(find_floor(cloud, np.array([0.0, 0.0, 1.0]))) < 1e-6
