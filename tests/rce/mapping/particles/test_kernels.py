"""Compiled inner loops of the particle filter."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from rce.mapping.geometry import Points, Pose
from rce.mapping.matching import ndt
from rce.mapping.particles import kernels

RATIO, VARIANCE = 4, 0.6
SIDE = ndt.TILE * RATIO  # fine cells along a tile
MIDDLE = np.array([[float(SIDE), float(SIDE), 0.0]])


def room() -> Points:
    """Return points, fine cells, frame of the robot, on the walls of a room 60 by 50 cells."""
    wide, deep = np.arange(-30.0, 30.0, 0.5), np.arange(-25.0, 25.0, 0.5)
    walls = [np.stack([wide, np.full_like(wide, y)], axis=1) for y in (-25.0, 25.0)]
    walls += [np.stack([np.full_like(deep, x), deep], axis=1) for x in (-30.0, 30.0)]
    return np.concatenate(walls) + np.random.default_rng(0).normal(0.0, 0.2, (2 * len(wide) + 2 * len(deep), 2))


class Maps:
    """Maps of `count` particles, 2 by 2 tiles each."""

    def __init__(self, count: int, tiles: int = 16) -> None:
        self.tiles = np.zeros((tiles, ndt.TILE, ndt.TILE, ndt.FIELDS), np.float32)
        self.tables = np.full((count, 2, 2), -1, np.int32)
        self.users = np.zeros(tiles, np.int32)

    def unshare(self, poses: NDArray[np.float64], points: Points) -> bool:
        return kernels.unshare(self.tiles, self.tables, self.users, poses, points, RATIO)

    def learn(self, poses: NDArray[np.float64], points: Points) -> None:
        assert self.unshare(poses, points)
        kernels.learn(self.tiles, self.tables, poses, points, RATIO, 0, len(poses))


@pytest.fixture
def known() -> Maps:
    """One map, which has the room."""
    maps = Maps(1)
    maps.learn(MIDDLE, room())
    return maps


def likelihood(maps: Maps, pose: Pose, points: Points, least: float = -math.inf) -> float:
    return kernels.log_likelihood(maps.tiles, maps.tables[0], points, *pose, RATIO, VARIANCE, least)


def test_tiles_are_given_where_points_lie() -> None:
    maps = Maps(2)
    poses = np.array([[10.0, 10.0, 0.0], [10.0, SIDE + 10.0, 0.0]])
    assert maps.unshare(poses, np.array([[0.0, 0.0], [1e6, 0.0]]))
    assert maps.tables.tolist() == [[[0, -1], [-1, -1]], [[-1, -1], [1, -1]]]
    assert maps.users.tolist() == [1, 1] + [0] * 14


def test_shared_tile_is_copied_and_an_own_one_is_not() -> None:
    maps = Maps(2)
    maps.tables[:, 0, 0], maps.users[0], maps.tiles[0] = 0, 2, 7.0
    assert maps.unshare(np.zeros((1, 3)), np.array([[5.0, 5.0]]))
    assert maps.tables[:, 0, 0].tolist() == [1, 0]
    assert maps.users[:3].tolist() == [1, 1, 0]
    assert (maps.tiles[1] == 7.0).all()
    assert maps.unshare(np.zeros((2, 3)), np.array([[5.0, 5.0]]))
    assert maps.tables[:, 0, 0].tolist() == [1, 0]


def test_used_tile_that_is_free_again_is_emptied() -> None:
    maps = Maps(1)
    maps.tiles[0] = 7.0
    assert maps.unshare(np.zeros((1, 3)), np.array([[5.0, 5.0]]))
    assert (maps.tiles[0] == 0.0).all()


def test_call_can_be_repeated_with_more_tiles() -> None:
    maps, points = Maps(1, tiles=1), np.array([[5.0, 5.0], [SIDE + 5.0, 5.0]])
    assert not maps.unshare(np.zeros((1, 3)), points)
    more = Maps(1, tiles=2)
    more.tables, more.users[:1] = maps.tables, maps.users
    assert more.unshare(np.zeros((1, 3)), points)
    assert more.tables[0, 0].tolist() == [0, 1]


def test_only_maps_in_the_range_learn() -> None:
    maps, poses = Maps(3), np.repeat(MIDDLE, 3, axis=0)
    assert maps.unshare(poses, room())
    kernels.learn(maps.tiles, maps.tables, poses, room(), RATIO, 1, 2)
    counts = [maps.tiles[table[table >= 0], ..., 0].sum() for table in maps.tables]
    assert counts == [0, len(room()), 0]


def test_right_pose_is_likelier_than_others(known: Maps) -> None:
    pose = Pose(SIDE, SIDE, 0.0)
    best = likelihood(known, pose, room())
    for shift in (Pose(3.0, 0.0, 0.0), Pose(0.0, -3.0, 0.0), Pose(0.0, 0.0, 0.1)):
        assert likelihood(known, pose @ shift, room()) < best - 20.0


def test_points_on_no_wall_are_outliers(known: Maps) -> None:
    inside = np.array([[0.0, 0.0], [5.0, 3.0], [1e6, 0.0]])
    assert likelihood(known, Pose(SIDE, SIDE, 0.0), inside) == pytest.approx(3 * math.log(kernels.OUTLIER))


def test_likelihood_below_the_least_is_not_computed_to_the_end(known: Maps) -> None:
    inside = np.zeros((100, 2))
    outlier = math.log(kernels.OUTLIER)
    assert likelihood(known, Pose(SIDE, SIDE, 0.0), inside, 10.5 * outlier) == pytest.approx(11 * outlier)
    assert likelihood(known, Pose(SIDE, SIDE, 0.0), inside, 100.5 * outlier) == pytest.approx(100 * outlier)


def test_thick_wall_explains_less() -> None:
    along = np.arange(-20.0, 20.0, 0.25)
    thin = np.stack([along, np.zeros_like(along)], axis=1)
    found = []
    for width in (0.1, 1.5):
        maps = Maps(1)
        maps.learn(MIDDLE, thin + np.random.default_rng(0).normal(0.0, width, thin.shape) * [0.0, 1.0])
        found.append(likelihood(maps, Pose(SIDE, SIDE, 0.0), thin))
    assert found[0] > found[1] + 10.0


def test_lattice_finds_the_nearest_of_its_poses(known: Maps) -> None:
    centre = np.array([SIDE - 4.0, SIDE + 8.0, 2 * kernels.TURN])
    expected = likelihood(known, Pose(SIDE, SIDE, 0.0), room())

    def search(least: float) -> tuple[float, ...]:
        return kernels.search_lattice(known.tiles, known.tables[0], room(), centre, RATIO, VARIANCE, least)

    assert search(-math.inf) == pytest.approx((SIDE, SIDE, 0.0, expected))
    assert search(expected + 1.0) == (*centre, expected + 1.0), "no pose is likelier"


def matched(maps: Maps, start: Pose, expected: Pose, jump: float) -> NDArray[np.float64]:
    found: NDArray[np.float64] = np.zeros((11,))
    starts, means = np.array([start]), np.array([expected])
    kernels.match(maps.tiles, maps.tables, room(), starts, means, found[None], RATIO, VARIANCE, 12, jump, 0, 1)
    return found


def test_points_are_fitted_from_the_start(known: Maps) -> None:
    start = Pose(SIDE + 1.0, SIDE - 1.0, 0.02)
    found = matched(known, start, start, 24.0)
    assert found[:3] == pytest.approx((SIDE, SIDE, 0.0), abs=0.2)
    assert found[9] == pytest.approx(likelihood(known, Pose(*found[:3].tolist()), room()))
    assert found[10] == 0.0


@pytest.mark.parametrize(("jump", "jumped"), [(24.0, True), (1e6, False)])
def test_pose_jumps_only_if_another_one_is_much_likelier(known: Maps, jump: float, jumped: bool) -> None:
    wrong = Pose(SIDE + 8.0, SIDE - 8.0, 2 * kernels.TURN)
    found = matched(known, wrong, wrong, jump)
    assert (found[10] == 1.0) == jumped
    assert (math.dist(found[:2], (SIDE, SIDE)) < 0.5) == jumped
