from __future__ import annotations

import numpy as np

from rce.mapping.particles.filter import ParticleFilter
from rce.mapping.particles.tiles import TileMaps

CORNER = np.array([[2.0, 0.01 * i] for i in range(100)] + [[0.01 * i, 1.0] for i in range(200)])


def counts(maps: TileMaps) -> list[float]:
    """Return the number of points in each map."""
    return [float(maps.tiles[table[table >= 0], ..., 0].sum()) for table in maps.tables]


def filter_of(count: int) -> ParticleFilter:
    found = ParticleFilter(count, seed=0)
    found.learn(CORNER)
    return found


def test_maps_share_tiles_until_they_differ() -> None:
    found = filter_of(3)
    single = found.maps.used // 3
    found.maps.resample(np.array([1, 1, 1]))
    assert found.maps.used == single
    assert counts(found.maps) == [300.0] * 3
    found.learn(CORNER[:1])  # changes one tile of each map
    assert counts(found.maps) == [301.0] * 3
    assert found.maps.used == single + 2


def test_changes_of_one_map_do_not_affect_another() -> None:
    maps = filter_of(2).maps
    maps.resample(np.array([0, 0]))
    before = counts(maps)
    apart = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    maps.unshare(apart[:1], CORNER)  # of the first map only
    assert maps.tables[0].max() != maps.tables[1].max()
    maps.tiles[maps.tables[0][maps.tables[0] >= 0]] = 0.0
    assert counts(maps) == [0.0, before[1]]


def test_tables_grow_in_all_directions() -> None:
    found = filter_of(2)
    before = counts(found.maps)
    poses = np.array([[90.0, -70.0, 0.0], [-120.0, 65.0, 0.0]])
    found.maps.grow_to_cover(poses, 5.0)
    assert counts(found.maps) == before
    np.testing.assert_allclose(found.maps.from_cells(found.maps.to_cells(poses)), poses)
    found.poses = poses
    found.learn(CORNER)
    assert counts(found.maps) == [600.0, 600.0]


def test_tiles_are_allocated_on_demand() -> None:
    found = ParticleFilter(4, seed=0)
    for x in range(0, 400, 4):
        found.poses[:, 0] = x
        found.learn(CORNER)
    assert counts(found.maps) == [30_000.0] * 4
