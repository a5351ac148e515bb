"""Messages by which a planning node gets its map; tests/e2e/test_planning.py gives a real node one."""

from __future__ import annotations

import numpy as np

from rce.mapping.publication import load_time, map_cdr
from rce.mapping.robot import grid_of
from tests.support.planning import grid_of as drawn


def test_map_is_the_same_after_serialisation() -> None:
    grid = drawn("#? ", "   ")
    cdr = map_cdr(grid, 1_700_000_000_123_456_789)
    assert load_time(cdr) == 1_700_000_000_123_456_789
    found = grid_of(cdr)
    assert np.array_equal(found.cells, grid.cells)
    assert (round(found.resolution, 6), found.x, found.y) == (grid.resolution, grid.x, grid.y)
