"""Floor plan of the apartment that the simulated robot drives through, and ranges of a laser in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Points
from rce.mapping.scans import beam_directions

WIDTH, DEPTH = 16.0, 11.0  # metres
CORRIDOR = (4.7, 6.3)  # lowest and highest y, metres
DOOR, THICKNESS = 0.95, 0.12  # metres; width of doors and of inner walls
LOWER_DOORS, UPPER_DOORS = (2.4, 8.3, 13.6), (3.0, 7.6, 12.9)  # x at which each door begins
LOWER_WALLS, UPPER_WALLS = (5.6, 10.4), (5.0, 10.9)  # x of the walls between rooms
FURNITURE = (  # x, y, width, depth; metres
    (0.4, 0.5, 0.9, 2.0),
    (2.6, 0.3, 1.8, 0.6),
    (6.0, 0.3, 2.0, 1.5),
    (9.5, 2.6, 0.6, 1.6),
    (12.0, 0.4, 2.6, 0.7),
    (15.2, 2.4, 0.5, 1.5),
    (0.4, 9.2, 2.1, 1.4),
    (4.2, 7.0, 0.5, 1.2),
    (5.4, 9.9, 2.6, 0.7),
    (9.8, 8.2, 0.8, 0.8),
    (11.3, 8.6, 0.7, 1.9),
    (14.2, 9.6, 1.4, 1.0),
    (4.9, 5.95, 1.3, 0.3),
)
# Waypoints: into every room and back through its door, along the corridor from end to end. Metres.
ROUTE = (
    (1.0, 5.5), (2.9, 5.4), (2.9, 4.0), (4.2, 2.4), (2.2, 1.8), (1.8, 3.6), (2.9, 4.1), (3.2, 5.5),
    (3.5, 6.9), (3.2, 8.2), (1.2, 8.2), (1.4, 7.2), (3.3, 7.2), (3.6, 5.4),
    (6.6, 5.3), (8.05, 5.6), (8.08, 7.2), (9.0, 9.2), (7.0, 9.0), (6.2, 7.4), (7.9, 7.1), (8.2, 5.5),
    (8.8, 4.2), (8.6, 2.4), (6.8, 2.6), (6.6, 3.8), (8.5, 4.0), (9.0, 5.4),
    (13.2, 5.6), (13.4, 7.2), (13.2, 9.4), (12.6, 8.0), (13.4, 6.8), (13.9, 5.4),
    (14.1, 4.0), (14.4, 2.0), (11.6, 1.8), (11.4, 3.6), (13.8, 3.9), (14.2, 5.4), (15.2, 5.6), (12.0, 5.4), (9.0, 5.3),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class FloorPlan:
    """Floor plan of line segments.

    Attributes:
        walls: (n, 2, 2) begin and end of each wall, metres, frame of the building.
    """

    walls: NDArray[np.float64]

    def ranges(self, x: float, y: float, theta: float, beams: int, field_of_view: float) -> NDArray[np.float64]:
        """Return the metres (beams,) to the nearest wall along each beam, infinite without one.

        Args:
            x: Laser, metres.
            y: Laser, metres.
            theta: Heading of the laser, radians.
            beams: Number of beams.
            field_of_view: Radians, symmetric around the heading.
        """
        increment = field_of_view / beams
        directions = beam_directions(beams, -field_of_view / 2, increment)
        c, s = np.cos(theta), np.sin(theta)
        directions = directions @ np.array([[c, s], [-s, c]])
        begin = self.walls[:, 0] - (x, y)
        along = self.walls[:, 1] - self.walls[:, 0]
        # Beams parallel to a wall give inf or nan, which is no hit.
        with np.errstate(divide="ignore", invalid="ignore"):
            across = directions[:, None, 0] * along[None, :, 1] - directions[:, None, 1] * along[None, :, 0]
            distance = (begin[:, 0] * along[:, 1] - begin[:, 1] * along[:, 0]) / across
            place = (begin[None, :, 0] * directions[:, None, 1] - begin[None, :, 1] * directions[:, None, 0]) / across
            hit = (distance > 0) & (place >= 0) & (place <= 1)
        nearest: NDArray[np.float64] = np.where(hit, distance, np.inf).min(axis=1)
        return nearest

    def distance(self, points: Points) -> NDArray[np.float64]:
        """Return the distance (n,) from each point (n, 2) to the nearest wall, metres."""
        begin, along = self.walls[:, 0], self.walls[:, 1] - self.walls[:, 0]
        offset = points[:, None, :] - begin[None]
        place = np.clip((offset * along).sum(axis=2) / (along * along).sum(axis=1), 0.0, 1.0)
        gap = offset - place[..., None] * along
        nearest: NDArray[np.float64] = np.sqrt((gap * gap).sum(axis=2)).min(axis=1)
        return nearest


def apartment() -> FloorPlan:
    """Return the plan of six furnished rooms on both sides of a corridor, 16 m by 11 m."""
    low, high = CORRIDOR
    lines = [
        *_box(0.0, 0.0, WIDTH, DEPTH),
        *_wall_with_doors(low, LOWER_DOORS),
        *_wall_with_doors(high, UPPER_DOORS),
    ]
    for x in LOWER_WALLS:
        lines += _box(x - THICKNESS / 2, 0.0, x + THICKNESS / 2, low)
    for x in UPPER_WALLS:
        lines += _box(x - THICKNESS / 2, high, x + THICKNESS / 2, DEPTH)
    for x, y, width, depth in FURNITURE:
        lines += _box(x, y, x + width, y + depth)
    return FloorPlan(np.array(lines))


Line = tuple[tuple[float, float], tuple[float, float]]


def _box(left: float, low: float, right: float, high: float) -> list[Line]:
    corners = [(left, low), (right, low), (right, high), (left, high)]
    return list(zip(corners, [*corners[1:], corners[0]], strict=True))


def _wall_with_doors(y: float, doors: tuple[float, ...]) -> list[Line]:
    """Return a wall along the corridor, centred on `y`, with a gap for each door."""
    begins, ends = [0.0, *(door + DOOR for door in doors)], [*doors, WIDTH]
    low, high = y - THICKNESS / 2, y + THICKNESS / 2
    return [line for begin, end in zip(begins, ends, strict=True) for line in _box(begin, low, end, high)]
