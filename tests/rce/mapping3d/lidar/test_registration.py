from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rce.mapping3d.lidar.registration import Surface, information_of, measured, register
from rce.mapping3d.poses import Floats, angle, distance, inverse, make_pose, transform

MOTION = make_pose(Rotation.from_euler("z", 5, degrees=True).as_matrix(), (0.3, -0.15, 0.02))


def room(seed: int, half: tuple[float, float, float] = (4.0, 3.0, 1.3), count: int = 6000) -> Floats:
    """Return points on the walls of a room, seen from its middle."""
    random = np.random.default_rng(seed)
    points = random.uniform(-1, 1, (count, 3)) * half
    axes = random.integers(0, 3, count)
    points[np.arange(count), axes] = random.choice([-1, 1], count) * np.array(half)[axes]
    return points + random.normal(0, 0.01, points.shape)


def test_motion_between_two_clouds_is_found() -> None:
    target, source = Surface(room(0)), Surface(transform(inverse(MOTION), room(1)))
    found = register(target, source, np.eye(4))
    off = inverse(MOTION) @ found.pose
    assert distance(off) < 0.01
    assert angle(off) < 0.003
    assert found.overlap > 0.95
    assert found.fit > 0.95


def test_wrong_motion_does_not_fit() -> None:
    assert measured(Surface(room(0)), Surface(room(1)), MOTION).fit < 0.6


def test_corridor_leaves_its_direction_open() -> None:
    points = room(0)
    surface = Surface(points[np.abs(points[:, 0]) < 3.5])
    information = information_of(surface.points, surface.normals)
    assert information[0, 0] < 0.01 * information[1, 1]


def test_lines_are_no_planes() -> None:
    around = np.linspace(0, 2 * np.pi, 2000)
    rings = [np.stack([r * np.cos(around), r * np.sin(around), -np.ones(2000)], axis=1) for r in (2.0, 3.0, 4.5)]
    assert len(Surface(np.concatenate(rings)).points) < 60


@pytest.mark.parametrize("count", [0, 5])
def test_cloud_without_planes_keeps_the_start(count: int) -> None:
    empty = Surface(np.zeros((count, 3)))
    for pair in ((empty, Surface(room(0))), (Surface(room(0)), empty)):
        found = register(*pair, MOTION)
        assert found.overlap == 0
        np.testing.assert_array_equal(found.pose, MOTION)
        np.testing.assert_array_equal(found.information, np.zeros((6, 6)))
