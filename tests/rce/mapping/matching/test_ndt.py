"""Normal distributions of hits, and the fit of points to them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from rce.mapping.geometry import Points, Pose
from rce.mapping.matching import ndt

RATIO = 4  # fine cells along a coarse one
VARIANCE = 0.6
SIDE = ndt.TILE * RATIO  # fine cells along a tile


def empty(rows: int = 2, columns: int = 2) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return tiles and table of an empty map."""
    table = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    return np.zeros((table.size, ndt.TILE, ndt.TILE, ndt.FIELDS), np.float32), table


def room() -> Points:
    """Return points, fine cells, on the four walls of a room around the middle of the map, with a little noise."""
    along = np.arange(-40.0, 40.0, 0.5)
    far = np.full_like(along, 40.0)
    walls = [np.stack(wall, axis=1) for wall in ((along, far), (along, -far), (far, along), (-far, along))]
    return np.concatenate(walls) + np.random.default_rng(0).normal(0.0, 0.3, (4 * len(along), 2))


def aligned(points: Points, start: Pose, expected: Pose, walls: Points, pull: float = ndt.PULL) -> list[float]:
    tiles, table = empty()
    ndt.learn(tiles, table, np.ascontiguousarray(walls + SIDE), RATIO)
    found: list[float] = ndt.align(tiles, table, points, *start, *expected, RATIO, VARIANCE, 30, pull).tolist()
    return found


def test_mean_and_covariance_of_the_hits_of_a_cell_are_learned() -> None:
    tiles, table = empty()
    hits = np.random.default_rng(0).uniform(8.0, 11.0, (60, 2))  # the cell of column and row 2
    ndt.learn(tiles, table, hits, RATIO)
    count, x, y, xx, xy, yy = tiles[0, 2, 2].tolist()
    assert count == 60
    np.testing.assert_allclose(np.array([x, y]) + 9.5, hits.mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose([[xx, xy], [xy, yy]], np.cov(hits.T, bias=True), rtol=1e-3, atol=1e-4)
    assert tiles[..., 0].sum() == 60


def test_old_hits_are_forgotten() -> None:
    tiles, table = empty()
    ndt.learn(tiles, table, np.full((200, 2), 8.5), RATIO)
    ndt.learn(tiles, table, np.full((800, 2), 10.5), RATIO)
    count, x = tiles[0, 2, 2, :2].tolist()
    assert count == ndt.MAX_HITS
    assert x + 9.5 == pytest.approx(10.5, abs=0.01)


def test_hits_outside_of_the_map_or_where_there_is_no_tile_are_ignored() -> None:
    tiles, table = empty()
    table[0, 1] = -1
    ndt.learn(tiles, table, np.array([[-1.0, 5.0], [5.0, 2.0 * SIDE], [SIDE + 1.0, 1.0], [1.0, SIDE + 1.0]]), RATIO)
    assert tiles[..., 0].sum() == 1
    assert tiles[2, 0, 0, 0] == 1


@pytest.mark.parametrize(("hits", "known"), [(0, False), (2, False), (3, True)])
def test_cell_is_known_from_some_hits_on(hits: int, known: bool) -> None:
    tiles, table = empty()
    ndt.learn(tiles, table, np.full((hits, 2), SIDE + 5.0), RATIO)
    tile, row, column = ndt.known_cell(tiles, table, ndt.TILE + 1, ndt.TILE + 1)
    assert (row, column) == (1, 1)
    assert tile == (3 if known else -1)


def test_cell_without_a_tile_is_unknown() -> None:
    tiles, table = empty()
    table[:] = -1
    assert ndt.known_cell(tiles, table, 0, 0)[0] == -1


@pytest.mark.parametrize("shift", [Pose(0.0, 0.0, 0.0), Pose(1.5, -1.0, 0.02), Pose(-1.0, 1.5, -0.03)], ids=str)
def test_pose_is_moved_to_where_the_points_fit(shift: Pose) -> None:
    start = Pose(SIDE, SIDE, 0.0) @ shift
    x, y, theta, *_ = aligned(room(), start, start, room())
    assert (x, y) == pytest.approx((SIDE, SIDE), abs=0.15)
    assert theta == pytest.approx(0.0, abs=0.003)


def test_information_is_symmetric_in_a_square_room() -> None:
    pose = Pose(SIDE, SIDE, 0.0)
    _, _, _, xx, xy, xt, yy, yt, tt = aligned(room(), pose, pose, room())
    assert np.linalg.eigvalsh([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]]).min() > 0
    assert xx == pytest.approx(yy, rel=0.1)


def test_expected_pose_decides_along_a_corridor() -> None:
    along = np.arange(-50.0, 50.0, 0.5)
    walls = np.concatenate([np.stack([along, np.full_like(along, side)], axis=1) for side in (-10.0, 10.0)])
    inner = walls[np.abs(walls[:, 0]) < 30.0]
    start, expected = Pose(SIDE, SIDE + 1.0, 0.01), Pose(SIDE + 3.0, SIDE, 0.0)
    x, y, _, xx, *_, yy, _, _ = aligned(inner, start, expected, walls, pull=1e-2)
    assert x == pytest.approx(SIDE + 3.0, abs=0.3)
    assert y == pytest.approx(SIDE, abs=0.2)
    assert yy > 10 * xx


def test_points_without_known_walls_stay_at_the_expected_pose() -> None:
    expected = Pose(SIDE + 2.0, SIDE, 0.1)
    x, y, theta, *_ = aligned(room(), Pose(SIDE, SIDE, 0.0), expected, np.full((1, 2), 1e6))
    assert (x, y, theta) == pytest.approx(expected, abs=0.01)
    assert math.isfinite(x + y + theta)
