from __future__ import annotations

import numpy as np

from rce.mapping3d.evaluation.room import QVGA
from rce.mapping3d.odometry.kernels import SIZE, SUMS, fill_normals, linearise

FLOATS = np.float32


def test_normals_of_a_slanted_plane_point_to_the_camera() -> None:
    # The plane z = 2 + 0.5 x.
    rays = QVGA.rays()
    depth = 2.0 / (1.0 - 0.5 * rays[:, :, 0])
    points = np.ascontiguousarray(rays * depth[:, :, None], FLOATS)
    normals = np.empty_like(points)
    fill_normals(points, normals)
    expected = np.array([0.5, 0.0, -1.0]) / np.sqrt(1.25)
    np.testing.assert_allclose(normals[50, 60], expected, atol=1e-3)
    assert not normals[0].any()


def test_pixel_at_an_edge_or_a_hole_has_no_normal() -> None:
    depth = np.full((240, 320), 2.0, FLOATS)
    depth[:, 160:] = 3.0
    depth[10, 10] = 0.0
    points = np.ascontiguousarray(QVGA.points(depth))
    normals = np.empty_like(points)
    fill_normals(points, normals)
    assert not normals[100, 160].any()
    assert not normals[10, 10].any()
    assert normals[100, 100].any()


def test_gradient_of_the_depth_points_away_from_the_wall() -> None:
    # A wall 2 m away was 1.98 m away: the motion along z that explains it is 2 cm.
    wall = np.full((240, 320), 2.0, FLOATS)
    points = np.ascontiguousarray(QVGA.points(np.full((240, 320), 1.98, FLOATS)).reshape(-1, 3)[::7])
    normals = np.tile(np.array([0.0, 0.0, -1.0], FLOATS), (len(points), 1))
    hessian, gradient, sums = np.zeros((SIZE, SIZE)), np.zeros(SIZE), np.zeros(SUMS)
    intrinsics = np.array([QVGA.fx, QVGA.fy, QVGA.cx, QVGA.cy, 0.001, 0.0019, 1.0])
    dark = np.full(len(points), -1.0, FLOATS)
    image = np.zeros((240, 320), FLOATS)
    linearise(points, normals, dark, image, wall, intrinsics, np.eye(4), 1.0, 0.0, 10.0, 5.0, hessian, gradient, sums)
    assert abs(-gradient[2] / hessian[2, 2] - 0.02) < 1e-6
    assert sums[1] == 0
    assert sums[5] == sums[3] == sums[6] > 0
