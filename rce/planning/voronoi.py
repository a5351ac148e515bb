"""Planner `voronoi`: paths that keep as far from obstacles as they can, along the ridges of the distance transform."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Points, Pose
from rce.mapping.matching.kernels import compiled
from rce.planning.astar import ends, path_over
from rce.planning.costmap import BLOCKED, HIGHEST, Costmap
from rce.planning.search.deadline import Deadline

APART = 2.0  # cells between the nearest obstacles of two cells on a ridge, at least
OFF_RIDGE = 20.0  # cost of a metre off the ridges, in metres on them


class Edge(NamedTuple):
    """Ridge between two junctions or ends.

    Attributes:
        points: (n, 2) its cells in order, metres, map frame.
        clearance: Least distance from an obstacle, metres.
    """

    points: Points
    clearance: float


def ridges(costmap: Costmap) -> NDArray[np.bool_]:
    """Return where (height, width) the generalised Voronoi diagram is, one cell wide, in cells that are not blocked.

    A cell is on a ridge if the obstacle nearest to it and the one nearest to its neighbour are farther from each other
    than from the cell: they are seen at an angle above 60 degrees.
    """
    free = (costmap.clearance > 0).astype(np.uint8)
    _, labels = cv2.distanceTransformWithLabels(free, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    rows, columns = np.nonzero(free == 0)
    nearest = np.zeros((int(labels.max()) + 1, 2), np.float32)
    nearest[labels[rows, columns]] = np.stack([columns, rows], axis=1)
    clearance = costmap.clearance / np.float32(costmap.resolution)
    found = np.zeros(free.shape, np.bool_)
    for here, there in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        gap = np.hypot(*np.moveaxis(nearest[labels[here]] - nearest[labels[there]], -1, 0))
        found[here] |= gap > np.maximum(np.maximum(clearance[here], clearance[there]), APART)
    found &= costmap.costs < BLOCKED
    thin(found)
    return found


@compiled("void(boolean[:,::1])")
def thin(cells: NDArray[np.bool_]) -> None:
    """Thin a shape (height, width) to lines of one cell, in place; cells on the edge must be false.

    Zhang and Suen, A Fast Parallel Algorithm for Thinning Digital Patterns, 1984.
    """
    rows, columns = np.array([-1, -1, 0, 1, 1, 1, 0, -1]), np.array([0, 1, 1, 1, 0, -1, -1, -1])
    candidates = np.argwhere(cells)
    around = np.zeros(8, np.bool_)
    changed = True
    while changed:
        changed = False
        for phase in range(2):
            removed = np.zeros(len(candidates), np.bool_)
            for index in range(len(candidates)):
                row, column = candidates[index]
                if not cells[row, column]:
                    continue
                for side in range(8):
                    around[side] = cells[row + rows[side], column + columns[side]]
                count, edges = 0, 0
                for side in range(8):
                    count += around[side]
                    edges += around[(side + 1) % 8] and not around[side]
                north, east, south, west = around[0], around[2], around[4], around[6]
                if phase == 0:
                    open_side = not (north and east and south) and not (east and south and west)
                else:
                    open_side = not (north and east and west) and not (north and south and west)
                removed[index] = 2 <= count <= 6 and edges == 1 and open_side
            for index in range(len(candidates)):
                if removed[index]:
                    cells[candidates[index, 0], candidates[index, 1]] = False
                    changed = True


def graph(costmap: Costmap) -> list[Edge]:
    """Return the Voronoi graph: the ridges between places where they meet or end, without closed ones."""
    cells = ridges(costmap)
    degree = cv2.filter2D(cells.astype(np.uint8), -1, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT) - 1
    junctions = cells & (degree != 2)
    chains = (cells & ~junctions).astype(np.uint8)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(chains, connectivity=8)
    edges = []
    for label in range(1, count):
        left, top, width, height, _ = boxes[label]
        window = np.s_[max(top - 1, 0) : top + height + 1, max(left - 1, 0) : left + width + 1]
        chain = labels[window] == label
        touching = cv2.dilate(chain.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(np.bool_) & junctions[window]
        rows, columns = _ordered(chain)
        offset = np.array([window[0].start, window[1].start])
        clearance = float(costmap.clearance[rows + offset[0], columns + offset[1]].min())
        if touching.any():
            edges.append(Edge(costmap.points(rows + offset[0], columns + offset[1]), clearance))
    return edges


def _ordered(chain: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows and columns of a chain of cells, from one end to the other."""
    left = {(int(row), int(column)) for row, column in np.argwhere(chain)}
    around = [(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1) if row or column]

    def neighbours(cell: tuple[int, int]) -> list[tuple[int, int]]:
        return [each for row, column in around if (each := (cell[0] + row, cell[1] + column)) in left]

    at = min(left, key=lambda cell: (len(neighbours(cell)), cell))
    order = [at]
    left.remove(at)
    while following := neighbours(at):
        at = min(following, key=lambda cell: abs(cell[0] - at[0]) + abs(cell[1] - at[1]))
        left.remove(at)
        order.append(at)
    rows, columns = np.array(order, np.int64).T
    return rows, columns


def voronoi(costmap: Costmap, start: Pose, goal: Pose, tolerance: float, deadline: Deadline) -> tuple[Points, float]:
    """Return a path that takes the shortest way to a ridge, follows the ridges, and takes the shortest way to the goal.

    Args:
        costmap: Costs of the cells.
        start: Start, map frame.
        goal: Goal, map frame.
        tolerance: Metres from the goal at which the path may end if the goal cannot be reached.
        deadline: Time limit.

    Returns:
        Points (n, 2), metres, map frame, and the length of the path, metres.

    Raises:
        NoPath: There is none.
    """
    ends(costmap, start, goal, tolerance)  # before the ridges, which take far longer to compute
    costs = np.where(costmap.costs < BLOCKED, np.uint8(HIGHEST), costmap.costs)
    costs[ridges(costmap)] = 0
    points, _ = path_over(costmap, costs, OFF_RIDGE - 1, (start, goal), tolerance, deadline)
    return points, float(np.hypot(*np.diff(points, axis=0).T).sum())
