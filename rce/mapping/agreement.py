"""Whether two places that seem to be the same agree on where walls are and where none are."""

from __future__ import annotations

import numpy as np

from rce.mapping.fields import square_around, thin
from rce.mapping.geometry import ORIGIN, Points, Pose
from rce.mapping.graph import PoseGraph, around
from rce.mapping.grid import GridMap

RESOLUTION = 0.1
VIEW = 15.0  # metres from a place that are compared
MOST = 5000  # points of a place
WALL = 32  # likelihood around a wall (0..255) at 0.2 m from it; a point further off is not on it
FREE = 35  # percent; of a cell that beams went through


class Surroundings:
    """The walls around a node and the space that is free there, by all nodes at most `way` metres along edges."""

    def __init__(self, graph: PoseGraph, number: int, way: float) -> None:
        frame = graph.nodes[number].pose
        points = np.concatenate(list(around(graph, number, way)))
        self.points = thin(points[np.hypot(*points.T) < VIEW], RESOLUTION, MOST)
        self._walls = square_around(ORIGIN, VIEW + 1.0, RESOLUTION)
        self._walls.add(self.points)
        free = GridMap(RESOLUTION)
        for other in graph.distances(number, way):
            at = frame.to(graph.nodes[other].pose)
            for sweep in graph.nodes[other].sweeps[:1]:  # the beams of the others went much the same ways
                free.insert(at.transform(sweep.sensor), at.transform(sweep.points.astype(np.float64)))
        self._free = free.render()

    def judge(self, points: Points) -> tuple[int, int]:
        """How many of the points (n, 2), metres, frame of the node, are on walls, and how many where none are."""
        on_wall = self._walls.at(points) > WALL
        seen = self._free.at(points)
        return int(on_wall.sum()), int(((seen >= 0) & (seen < FREE) & ~on_wall).sum())


def agreement(first: Surroundings, second: Surroundings, motion: Pose) -> float:
    """The share, of what one has seen as a wall and the other has seen too, that is a wall for both (0..1; the
    acceptance index of Birk and Carpin, Merging Occupancy Grid Maps From Multiple Mobile Robots, 2006). `motion`: of
    the second's node in the frame of the first's."""
    one = first.judge(motion.transform(second.points))
    other = second.judge(motion.inverse().transform(first.points))
    same, different = one[0] + other[0], one[1] + other[1]
    return same / max(same + different, 1)
