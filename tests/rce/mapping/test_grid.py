from __future__ import annotations

import numpy as np
import pytest

from rce.mapping.grid import GridMap, OccupancyGrid

WALL = np.stack([np.full(150, 2.003), np.linspace(-1.0, 1.0, 150)], axis=1)


def value(grid: OccupancyGrid, x: float, y: float) -> int:
    """Return the cell at a point in metres, map frame."""
    return int(grid.cells[int((y - grid.y) // grid.resolution), int((x - grid.x) // grid.resolution)])


SENSOR = np.zeros((1, 2))


@pytest.mark.parametrize("resolution", [0.02, 0.05, 0.1])
def test_cells_are_free_before_a_wall_and_unknown_behind(resolution: float) -> None:
    grid = GridMap(resolution)
    for _ in range(4):
        grid.insert(SENSOR, np.concatenate([WALL, [[2.5, 1.5]]]))
    seen = grid.render()
    assert value(seen, 1.0, 0.1) < 20
    assert value(seen, 2.003, 0.1) > 65
    assert value(seen, 2.3, -0.5) == -1


def test_empty_grid_is_one_unknown_cell() -> None:
    assert GridMap(0.05).render().cells.tolist() == [[-1]]


def test_growing_does_not_move_cells() -> None:
    small, large = GridMap(0.05), GridMap(0.05)
    small.insert(SENSOR, WALL)
    large.insert(SENSOR, WALL)
    for x, y in ((-45.0, 3.0), (50.0, -60.0), (2.0, 70.0)):
        large.insert(np.array([[x, y]]), WALL + np.array([x, y]))
    before, after = small.render(), large.render()
    column, row = round((before.x - after.x) / 0.05), round((before.y - after.y) / 0.05)
    height, width = before.cells.shape
    np.testing.assert_array_equal(after.cells[row : row + height, column : column + width], before.cells)


def test_wall_that_was_removed_becomes_free() -> None:
    grid = GridMap(0.05)
    grid.insert(SENSOR, np.array([[1.02, 0.02]]))
    assert value(grid.render(), 1.02, 0.02) > 65
    for _ in range(20):
        grid.insert(SENSOR, np.array([[2.02, 0.02]]))
    assert value(grid.render(), 1.02, 0.02) < 20
