"""Smoother paths over cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Points
from rce.planning.costmap import BLOCKED, Costmap

ITERATIONS, PULL, STAY = 60, 0.3, 0.05  # weights of the straight line and of the original path


def smooth(costmap: Costmap, points: Points) -> Points:
    """Pull the points (n, 2) of a path towards the middle of their neighbours, as the simple smoother of Nav2 does.

    The ends stay. A point stays where it was if it, or the way to one of its neighbours, would be blocked or would cost
    more than before.
    """
    path = points.copy()
    limit = np.maximum(_costs(costmap, points), 1)
    for _ in range(ITERATIONS if len(points) > 2 else 0):
        moved = path.copy()
        moved[1:-1] += PULL * (path[:-2] + path[2:] - 2 * path[1:-1]) + STAY * (points[1:-1] - path[1:-1])
        worse = _costs(costmap, moved) > limit
        moved[worse] = path[worse]
        # A way between two points is as good as its middle, since points are a cell apart.
        blocked = _costs(costmap, (moved[:-1] + moved[1:]) / 2) >= BLOCKED
        touched = np.zeros(len(path), np.bool_)
        touched[:-1] |= blocked
        touched[1:] |= blocked
        moved[touched] = path[touched]
        path = moved
    return path


def _costs(costmap: Costmap, points: Points) -> NDArray[np.int64]:
    column, row = np.floor((points - costmap.corner) / costmap.resolution).astype(np.int64).T
    costs: NDArray[np.int64] = costmap.costs[row, column].astype(np.int64)
    return costs


def with_headings(points: Points, last: float) -> NDArray[np.float64]:
    """Return poses (n, 4) x, y, theta, 1 (forward): each heads for the next, and the last has the heading `last`."""
    ahead = np.diff(points, axis=0)
    theta = np.append(np.arctan2(ahead[:, 1], ahead[:, 0]), last)
    return np.column_stack([points, theta, np.ones(len(points))])
