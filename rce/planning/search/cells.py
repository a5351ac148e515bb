"""Compiled shortest paths on the cells of a costmap: A* (Hart, Nilsson and Raphael 1968) and Dijkstra's algorithm.

Costs are whole numbers, so that paths are optimal exactly: a straight step into a free cell costs `STRAIGHT`, a
diagonal one `DIAGONAL`. The open list is a ring of buckets, one for each total cost (Dial, Algorithm 360, 1969).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rce.mapping.matching.kernels import compiled
from rce.planning.costmap import BLOCKED, HIGHEST

STRAIGHT, DIAGONAL = 70, 99  # 99/70 is sqrt(2) up to 0.005 %
UNREACHED = np.iinfo(np.int32).max
LIMIT = UNREACHED // 2  # costs of longer paths would overflow: these are half a million kilometres in cells of 5 cm
NOT_FOUND, STOPPED = -1, -2
FIRST = 8  # direction of arrival at the start
CHECK_EVERY = 4096  # expanded cells from one look at the flag `stop` to the next

Cells = NDArray[np.int32]


def step_costs(cost_travel_multiplier: float) -> tuple[Cells, Cells, int]:
    """Return what steps into cells of each cost (256,) cost, as Nav2's Smac 2D planner counts it, and a ring's size.

    A step of length l into a cell of cost c costs l (1 + m c / 252), where m is the multiplier.

    Returns:
        Costs of straight steps, of diagonal steps, and a power of two above the greatest change of a total cost.
    """
    factor = 1.0 + cost_travel_multiplier * np.minimum(np.arange(256), HIGHEST) / HIGHEST
    straight, diagonal = (np.rint(length * factor).astype(np.int32) for length in (STRAIGHT, DIAGONAL))
    return straight, diagonal, 1 << math.ceil(math.log2(int(diagonal.max()) + DIAGONAL + 2))


@compiled("boolean(uint8[::1], int64, int64)")
def is_uniform(costs: NDArray[np.uint8], width: int, cell: np.int64) -> bool:
    """Return whether a cell and its eight neighbours cost the same; the cell must not be on the edge."""
    price = costs[np.uint64(cell)]
    for middle in (cell - width, cell, cell + width):
        place = np.uint64(middle)
        if costs[place - np.uint64(1)] != price or costs[place] != price or costs[place + np.uint64(1)] != price:
            return False
    return True


@compiled(
    "int64(uint8[::1], int64, int64, int64, int32[::1], int32[::1], int64, int64, float64, int32[::1], uint8[::1], "
    "uint8[::1])"
)
def search(
    costs: NDArray[np.uint8],
    width: int,
    start: int,
    goal: int,
    straight: Cells,
    diagonal: Cells,
    ring: int,
    informed: int,
    extent: float,
    reached: Cells,
    arrivals: NDArray[np.uint8],
    stop: NDArray[np.uint8],
) -> int:
    """Find the cheapest path from one cell to another.

    A path never turns by 135 degrees or more: the cell before leads to the next one directly, for less. So only five of
    the eight neighbours are looked at. Where all nine cells cost the same, only straight on, and after a diagonal step
    45 degrees to each side: another path over these cells is as cheap (Harabor and Grastien, Online Graph Pruning for
    Pathfinding on Grid Maps, 2011, section 3: the natural neighbours).

    Args:
        costs: (n,) costs of the cells, rows one after the other; those on the edge must be blocked.
        width: Cells in a row.
        start: Index of the first cell.
        goal: Index of the last cell.
        straight: (256,) cost of a straight step into a cell of each cost.
        diagonal: (256,) cost of a diagonal step.
        ring: Number of buckets, a power of two; see `step_costs`.
        informed: 1 for A* with the octile distance as heuristic, 0 for Dijkstra's algorithm.
        extent: 0 to end at the goal; otherwise go on until all cells within this multiple of its cost are reached.
        reached: (n,) filled with the cost of the path to each cell: `UNREACHED` without one, 0 if it is blocked.
        arrivals: (n,) filled with the direction 0..7 of the last step to each cell, in turns of 45 degrees.
        stop: (1,) another thread sets it to end the search.

    Returns:
        Cost of the path, NOT_FOUND or STOPPED.
    """
    # Indices are unsigned, which spares a test for negative ones at each access.
    columns, rows = np.array([1, 1, 0, -1, -1, -1, 0, 1]), np.array([0, 1, 1, 1, 0, -1, -1, -1])
    moves = rows * width + columns
    goal_column, goal_row = goal % width, goal // width
    heads = np.full(ring, -1, np.int32)
    mask = ring - 1
    # Entries of the open list: cell, its cost, and the next entry in the bucket or in the list of unused ones.
    entries = np.empty((1 << 14, 3), np.int32)
    used, unused, waiting = 1, -1, 1
    for index in range(costs.size):
        reached[index] = 0 if costs[index] >= BLOCKED else UNREACHED
    reached[start], arrivals[start] = 0, FIRST
    dx, dy = abs(goal_column - start % width), abs(goal_row - start // width)
    total = informed * (STRAIGHT * max(dx, dy) + (DIAGONAL - STRAIGHT) * min(dx, dy))
    entries[0, 0], entries[0, 1], entries[0, 2] = start, 0, -1
    heads[total & mask] = 0
    last, expanded = np.int64(LIMIT), 0
    while waiting > 0:
        bucket = np.uint64(total & mask)
        entry = heads[bucket]
        if entry < 0:
            total += 1
            continue
        if total > last:
            break
        place = np.uint64(entry)
        cell, cost = np.int64(entries[place, 0]), np.int64(entries[place, 1])
        heads[bucket] = entries[place, 2]
        entries[place, 2], unused = unused, entry
        waiting -= 1
        if cost != reached[np.uint64(cell)]:
            continue  # a cheaper path was found meanwhile
        if cell == goal:
            if extent == 0.0:
                return int(cost)
            last = np.int64(cost * extent)
        expanded += 1
        if expanded % CHECK_EVERY == 0 and stop[0]:
            return STOPPED
        row = np.int64(np.uint32(cell) // np.uint32(width))
        across, along = goal_column - (cell - row * width), goal_row - row
        arrival = np.int64(arrivals[np.uint64(cell)])
        turns, first = 5, arrival + 6
        if arrival == FIRST:
            turns, first = 8, np.int64(0)
        elif is_uniform(costs, width, cell):
            turns, first = (3, arrival + 7) if arrival & 1 else (1, arrival)
        for turn in range(first, first + turns):
            direction = np.uint64(turn & 7)
            to = np.uint64(cell + moves[direction])
            length = DIAGONAL if turn & 1 else STRAIGHT
            if reached[to] <= cost + length:  # also if it is blocked
                continue
            price = costs[to]
            new = cost + (diagonal[price] if turn & 1 else straight[price])
            if new >= reached[to] or new > LIMIT:
                continue
            reached[to], arrivals[to] = new, direction
            estimate = np.int64(new)
            if informed:
                dx, dy = abs(across - columns[direction]), abs(along - rows[direction])
                estimate += STRAIGHT * max(dx, dy) + (DIAGONAL - STRAIGHT) * min(dx, dy)
            if unused >= 0:
                entry, unused = unused, int(entries[np.uint64(unused), 2])
            else:
                if used == entries.shape[0]:
                    grown = np.empty((2 * used, 3), np.int32)
                    grown[:used] = entries
                    entries = grown
                entry = used
                used += 1
            place, bucket = np.uint64(entry), np.uint64(estimate & mask)
            entries[place, 0], entries[place, 1], entries[place, 2] = to, new, heads[bucket]
            heads[bucket] = entry
            waiting += 1
    return int(reached[goal]) if extent > 0.0 and reached[goal] != UNREACHED else NOT_FOUND


@compiled("int64[::1](uint8[::1], int64, int64)")
def trace(arrivals: NDArray[np.uint8], width: int, goal: int) -> NDArray[np.int64]:
    """Return the cells (n,) from the start of a search to `goal`, which it has reached."""
    columns = np.array([1, 1, 0, -1, -1, -1, 0, 1])
    rows = np.array([0, 1, 1, 1, 0, -1, -1, -1])
    count, cell = 1, goal
    while arrivals[cell] != FIRST:
        cell -= rows[arrivals[cell]] * width + columns[arrivals[cell]]
        count += 1
    path = np.empty(count, np.int64)
    cell = goal
    for index in range(count - 1, -1, -1):
        path[index] = cell
        if index:
            cell -= rows[arrivals[cell]] * width + columns[arrivals[cell]]
    return path
