from __future__ import annotations

import numpy as np

from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.particle_filter import ParticleFilter
from rce.mapping.paths import Paths
from rce.mapping.tiles import TileMaps

CORNER = np.array([[2.0, 0.01 * i] for i in range(100)] + [[0.01 * i, 1.0] for i in range(200)])


def counts(maps: TileMaps) -> list[float]:
    """How many points each map holds."""
    return [float(maps.tiles[table[table >= 0], ..., 0].sum()) for table in maps.tables]


def filter_of(count: int) -> ParticleFilter:
    found = ParticleFilter(count, seed=0)
    found.learn(CORNER)
    return found


def test_maps_share_tiles_until_they_learn() -> None:
    found = filter_of(3)
    single = found.maps.used // 3
    found.maps.resample(np.array([1, 1, 1]))
    assert found.maps.used == single
    assert counts(found.maps) == [300.0] * 3
    found.learn(CORNER[:1])  # one tile of each
    assert counts(found.maps) == [301.0] * 3
    assert found.maps.used == single + 2


def test_one_map_does_not_see_what_another_learns() -> None:
    maps = filter_of(2).maps
    maps.resample(np.array([0, 0]))
    before = counts(maps)
    apart = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    maps.claim(apart[:1], CORNER)  # only the first
    assert maps.tables[0].max() != maps.tables[1].max()
    maps.tiles[maps.tables[0][maps.tables[0] >= 0]] = 0.0
    assert counts(maps) == [0.0, before[1]]


def test_tables_grow_to_all_sides() -> None:
    found = filter_of(2)
    before = counts(found.maps)
    poses = np.array([[90.0, -70.0, 0.0], [-120.0, 65.0, 0.0]])
    found.maps.cover(poses, 5.0)
    assert counts(found.maps) == before
    np.testing.assert_allclose(found.maps.from_cells(found.maps.to_cells(poses)), poses)
    found.poses = poses
    found.learn(CORNER)
    assert counts(found.maps) == [600.0, 600.0]


def test_there_are_always_enough_tiles() -> None:
    found = ParticleFilter(4, seed=0)
    for x in range(0, 400, 4):
        found.poses[:, 0] = x
        found.learn(CORNER)
    assert counts(found.maps) == [30_000.0] * 4


def test_paths_keep_what_they_share_once() -> None:
    paths = Paths(3)
    for i in range(4):
        paths.append(np.full((3, 3), 10.0 * i) + np.arange(3)[:, None])
    paths.resample(np.array([0, 0, 1]))
    assert paths.open.shape == (3, 4, 3)
    paths.append(np.arange(9.0).reshape(3, 3))
    paths.resample(np.array([1, 1, 1]))
    assert (len(paths.stem), paths.open.shape[1], len(paths)) == (5, 0, 5)
    np.testing.assert_array_equal(paths.of(2)[:, 0], [0.0, 10.0, 20.0, 30.0, 3.0])


def test_particles_follow_both_motions_of_a_doubtful_one() -> None:
    found = filter_of(4)
    there = CORNER - np.array([0.8, 0.0])
    found.move(ORIGIN, np.diag([1e-4, 1e-4, 1e-5]), there, other=Pose(0.8, 0.0, 0.0))
    np.testing.assert_allclose(found.poses[1::2], np.tile([0.8, 0.0, 0.0], (2, 1)), atol=0.1)
    assert found.log_weights[::2].max() < -2.0 < found.log_weights[1::2].min()


def test_particles_that_explain_the_scan_replace_those_that_do_not() -> None:
    found = filter_of(4)
    found.poses = np.array([[0.6, 0.6, 0.3], [0.0, 0.0, 0.0], [0.5, -0.6, -0.3], [-0.6, 0.6, 0.3]])
    found.move(ORIGIN, np.diag([1e-4, 1e-4, 1e-5]), CORNER)
    assert found.best == 1
    assert np.sort(found.log_weights)[-2] < -3.0
    found.resample()
    assert np.hypot(*found.poses[:, :2].T).max() < 0.1
    assert (found.log_weights == 0.0).all()


def test_particles_that_explain_the_scan_equally_well_do_not_die_of_chance() -> None:
    """Else they have one ancestor a few steps ago, and all are wrong in the same way where a loop closes."""
    found = filter_of(30)
    for _ in range(40):
        found.move(ORIGIN, np.diag([1e-3, 1e-3, 1e-4]), CORNER)
        found.learn(CORNER)
        found.resample()
    ancestors = {tuple(pose) for pose in found.paths.open[:, 0].tolist()}
    assert not len(found.paths.stem)
    assert len(ancestors) > 10
