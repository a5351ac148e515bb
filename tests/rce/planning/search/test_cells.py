"""A* and Dijkstra's algorithm on cells."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rce.planning.costmap import BLOCKED, Costmap
from rce.planning.search.cells import NOT_FOUND, STOPPED, UNREACHED, search, step_costs, trace
from tests.support.planning import ROBOT, exhaustive, random_map


def run(costmap: Costmap, start: int, goal: int, multiplier: float, informed: int, stop: int = 0) -> tuple[int, float]:
    """Return the cost that the search claims, and the sum of the steps of its path."""
    costs = costmap.costs
    straight, diagonal, ring = step_costs(multiplier)
    reached, arrivals = np.empty(costs.size, np.int32), np.empty(costs.size, np.uint8)
    flag = np.array([stop], np.uint8)
    found = search(
        *(costs.ravel(), costs.shape[1], start, goal),
        *(straight, diagonal, ring, informed, 0.0, reached, arrivals, flag),
    )
    if found < 0:
        return found, 0.0
    path = trace(arrivals, costs.shape[1], goal)
    assert (path[0], path[-1]) == (start, goal)
    steps = np.abs(np.diff(path))
    prices = np.where(np.isin(steps, (1, costs.shape[1])), straight[costs.ravel()[path[1:]]], 0)
    prices = np.where(prices == 0, diagonal[costs.ravel()[path[1:]]], prices)
    assert (costs.ravel()[path] < BLOCKED).all()
    return found, float(prices.sum())


@settings(max_examples=60)
@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.5, 2.0, 20.0]), st.floats(0.0, 0.3))
def test_paths_cost_exactly_what_an_exhaustive_search_finds(seed: int, multiplier: float, share: float) -> None:
    costmap = Costmap(random_map(seed, share=share), ROBOT)
    free = np.flatnonzero(costmap.costs.ravel() < BLOCKED)
    if len(free) < 2:
        return
    start, goal = (int(each) for each in np.random.default_rng(seed).choice(free, 2, replace=False))
    best = exhaustive(costmap, start, multiplier)[goal]
    for informed in (0, 1):
        found, steps = run(costmap, start, goal, multiplier, informed)
        assert found == (best if np.isfinite(best) else NOT_FOUND)
        assert found == NOT_FOUND or steps == best


def test_costs_of_all_cells_within_the_extent_are_exact() -> None:
    costmap = Costmap(random_map(3), ROBOT)
    width = costmap.costs.shape[1]
    start = int(np.flatnonzero(costmap.costs.ravel() < BLOCKED)[0])
    straight, diagonal, ring = step_costs(2.0)
    best = exhaustive(costmap, start, 2.0)
    goal = int(np.where(np.isfinite(best), best, -1).argmax())
    reached, arrivals = np.empty(best.size, np.int32), np.empty(best.size, np.uint8)
    flag = np.zeros(1, np.uint8)
    search(costmap.costs.ravel(), width, start, goal, straight, diagonal, ring, 0, 1.0, reached, arrivals, flag)
    within = np.isfinite(best)
    assert (reached[within] == best[within]).all()
    assert (reached[~within & (costmap.costs.ravel() < BLOCKED)] == UNREACHED).all()


def test_flag_stops_the_search() -> None:
    costmap = Costmap(random_map(0, 200, 0.0), ROBOT)
    width = costmap.costs.shape[1]
    assert run(costmap, 10 * width + 10, 190 * width + 190, 2.0, 0, stop=1)[0] == STOPPED


@pytest.mark.parametrize("multiplier", [0.0, 2.0, 100.0])
def test_ring_is_a_power_of_two_above_every_change_of_a_total_cost(multiplier: float) -> None:
    _, diagonal, ring = step_costs(multiplier)
    assert ring & (ring - 1) == 0
    assert ring > diagonal.max() + 99
