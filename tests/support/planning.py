"""Maps for the tests of planning."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from rce.mapping.grid import OccupancyGrid
from rce.planning.costmap import BLOCKED, Costmap
from rce.planning.footprint import Footprint
from rce.planning.search.cells import step_costs

RESOLUTION = 0.1
ROBOT = Footprint.circle(0.15)


def grid_of(*rows: str) -> OccupancyGrid:
    """Return a map of a drawing, highest y first: `#` occupied, `?` unknown."""
    values = {"#": 100, "?": -1}
    cells = np.array([[values.get(each, 0) for each in row] for row in rows[::-1]], np.int8)
    return OccupancyGrid(cells, RESOLUTION, 0.0, 0.0)


def random_map(seed: int, size: int = 40, share: float = 0.12) -> OccupancyGrid:
    """Return a square map in which a share of the cells, chosen at random, are obstacles."""
    cells = np.where(np.random.default_rng(seed).random((size, size)) < share, 100, 0).astype(np.int8)
    return OccupancyGrid(cells, RESOLUTION, 0.0, 0.0)


def walled(size: int = 100, gap: int = 20) -> OccupancyGrid:
    """Return a square map with a wall in its middle that leaves a gap at the top."""
    cells = np.zeros((size, size), np.int8)
    cells[: size - gap, size // 2 : size // 2 + 2] = 100
    return OccupancyGrid(cells, RESOLUTION, 0.0, 0.0)


def exhaustive(costmap: Costmap, start: int, multiplier: float) -> NDArray[np.float64]:
    """Return the cost of the cheapest path from a cell to each cell (n,), by SciPy over all eight neighbours."""
    costs = costmap.costs.ravel()
    width = costmap.costs.shape[1]
    straight, diagonal, _ = step_costs(multiplier)
    free = np.flatnonzero(costs < BLOCKED)
    begins, ends, weights = [], [], []
    for row in (-1, 0, 1):
        for column in (-1, 0, 1):
            there = free + row * width + column
            open_cells = (costs[there] < BLOCKED) & (there != free)
            steps = diagonal if row and column else straight
            begins.append(free[open_cells])
            ends.append(there[open_cells])
            weights.append(steps[costs[there[open_cells]]])
    shape = (costs.size, costs.size)
    edges = csr_array((np.concatenate(weights), (np.concatenate(begins), np.concatenate(ends))), shape=shape)
    found: NDArray[np.float64] = dijkstra(edges, indices=start)
    return found
