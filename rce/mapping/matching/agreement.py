"""Agreement of two views of what may be one place, on walls and on free space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.grid import GridMap
from rce.mapping.matching.fields import downsample, square_around
from rce.mapping.pose_graph.graph import PoseGraph, points_around


@dataclass(frozen=True, slots=True)
class AgreementSettings:
    """Settings of the comparison of two places.

    Attributes:
        resolution: Metres per cell of the walls and of the free space.
        view: Metres from a place that are compared; further off, a small error of the angle moves points too far.
        max_points: Maximum number of points of a place.
        wall: Likelihood (0..255) from which on a point is on a wall: that at 0.2 m from one.
        free: Percent below which a cell is free.
    """

    resolution: float = 0.1
    view: float = 15.0
    max_points: int = 5000
    wall: int = 32
    free: int = 35


SETTINGS = AgreementSettings()


class Surroundings:
    """Walls around a node of a pose graph and the free space there.

    Attributes:
        points: (n, 2) points on walls, metres, frame of the node.
    """

    def __init__(self, graph: PoseGraph, number: int, way: float) -> None:
        """Collect what the nodes at most `way` metres along edges from node `number` have seen."""
        frame = graph.nodes[number].pose
        points = np.concatenate(list(points_around(graph, number, way)))
        self.points = downsample(points[np.hypot(*points.T) < SETTINGS.view], SETTINGS.resolution, SETTINGS.max_points)
        self._walls = square_around(ORIGIN, SETTINGS.view + 1.0, SETTINGS.resolution)
        self._walls.add(self.points)
        free = GridMap(SETTINGS.resolution)
        for other in graph.distances(number, way):
            at = frame.to(graph.nodes[other].pose)
            for sweep in graph.nodes[other].sweeps[:1]:  # the other sweeps of a node cover nearly the same space
                free.insert(*sweep.seen_from(at))
        self._free = free.render()

    def count(self, points: Points) -> tuple[int, int]:
        """Return how many points (n, 2), metres, frame of the node, are on walls, and how many in free space."""
        on_wall = self._walls.at(points) > SETTINGS.wall
        seen = self._free.at(points)
        return int(on_wall.sum()), int(((seen >= 0) & (seen < SETTINGS.free) & ~on_wall).sum())


def agreement(first: Surroundings, second: Surroundings, motion: Pose) -> float:
    """Return the share of walls seen from one place, and visible from the other, that are walls for both (0..1).

    This is the acceptance index of Birk and Carpin, Merging Occupancy Grid Maps From Multiple Mobile Robots, 2006.

    Args:
        first: One place.
        second: The other place.
        motion: Pose of the second's node in the frame of the first's.
    """
    one = first.count(motion.transform(second.points))
    other = second.count(motion.inverse().transform(first.points))
    same, different = one[0] + other[0], one[1] + other[1]
    return same / max(same + different, 1)
