from __future__ import annotations

import numpy as np
import pytest

from rce.mapping.matching.fields import Field, downsample

WALL = np.stack([np.full(150, 2.003), np.linspace(-1.0, 1.0, 150)], axis=1)


def field() -> Field:
    return Field((-1.0, -3.0), (4.0, 3.0), 0.05)


def test_likelihood_decreases_with_the_distance_from_a_wall() -> None:
    walls = field()
    walls.add(WALL)
    column, row = np.rint(walls.to_cells(np.array([[2.003, 0.0]]))[0]).astype(int)
    across = walls.likelihood[row, column : column + 6].astype(int)
    assert across[0] > 240
    assert (np.diff(across) < 0).all()
    assert across[5] < 20
    assert walls.tiles[..., 0].sum() == len(WALL)


def test_points_outside_are_ignored() -> None:
    walls = field()
    walls.add(np.array([[100.0, 0.0], [0.0, -100.0], [-0.999, -2.999]]))
    assert walls.likelihood.max() == 0


def test_coordinates_are_converted_to_cells() -> None:
    walls = field()
    low, high = walls.bounds
    np.testing.assert_allclose(low, [-1.0, -3.0])
    np.testing.assert_allclose(high, [4.0, 3.0])
    np.testing.assert_allclose(walls.to_cells(np.array([[-0.975, -2.975]])), [[0.0, 0.0]], atol=1e-9)


@pytest.mark.parametrize("level", [1, 2, 3])
def test_level_of_pyramid_bounds_all_levels_below(level: int) -> None:
    walls = field()
    walls.add(WALL)
    pyramid, size = walls.pyramid(4), 1 << level
    for row, column in ((60, 55), (40, 60), (117, 60), (78, 99), (119, 97)):
        below = pyramid[0, row : row + size, column : column + size]
        assert pyramid[level, row, column] == below.max()


def test_points_are_downsampled_evenly() -> None:
    dense, sparse = np.full((500, 2), 0.01), np.array([[1.0, 1.0], [-2.0, 3.0]])
    kept = downsample(np.concatenate([dense, sparse]), 0.1, 100)
    np.testing.assert_array_equal(kept, [[0.01, 0.01], [1.0, 1.0], [-2.0, 3.0]])
    assert len(downsample(np.random.default_rng(0).uniform(-5, 5, (1000, 2)), 0.1, 100)) == 100
