"""Outline of a robot on the ground."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from rce.errors import InvalidRequest
from rce.mapping.geometry import Points

MAX_SIZE = 100.0  # metres
FORM = "a radius in metres, as 0.2, or corners, as [[0.3, 0.2], [0.3, -0.2], [-0.3, -0.2], [-0.3, 0.2]]"


@dataclass(frozen=True, slots=True)
class Footprint:
    """A circle or a polygon around the origin of the robot's frame.

    Attributes:
        inscribed: Radius of the largest circle around the origin that is within the outline, metres.
        circumscribed: Radius of the smallest circle around the origin that has the outline within, metres.
        corners: Corners x, y of the polygon, metres, robot frame; empty for a circle, whose two radii are the same.
    """

    inscribed: float
    circumscribed: float
    corners: tuple[tuple[float, float], ...] = ()

    @staticmethod
    def circle(radius: float) -> Footprint:
        """Return a circle around the origin.

        Raises:
            InvalidRequest: The radius is not a positive number of metres.
        """
        if not 0.0 < radius <= MAX_SIZE:
            raise InvalidRequest(f"the radius of the robot is {radius} m; it must be above 0 m, up to {MAX_SIZE:g} m")
        return Footprint(radius, radius)

    @staticmethod
    def polygon(corners: tuple[tuple[float, float], ...]) -> Footprint:
        """Return a polygon with these corners in order; x, y in metres, robot frame.

        Raises:
            InvalidRequest: There are fewer than three corners, they are too far away, or the origin is not inside.
        """
        outline = np.array(corners, np.float64).reshape(-1, 2)
        if len(outline) < 3 or not (np.abs(outline) <= MAX_SIZE).all():
            raise InvalidRequest(f"a footprint needs three corners or more, up to {MAX_SIZE:g} m away")
        inside = cv2.pointPolygonTest(outline.astype(np.float32), (0.0, 0.0), measureDist=True)
        if inside <= 0:
            raise InvalidRequest("the origin of the robot's frame is not inside its footprint")
        return Footprint(inside, float(np.hypot(*outline.T).max()), tuple(corners))

    @staticmethod
    def parse(text: str) -> Footprint:
        """Return the footprint that a text describes: a radius, or the list of corners that Nav2 uses.

        Raises:
            InvalidRequest: The text is neither.
        """
        try:
            found: Any = json.loads(text)
            if isinstance(found, int | float) and not isinstance(found, bool):
                return Footprint.circle(float(found))
            return Footprint.polygon(tuple((float(x), float(y)) for x, y in found))
        except (TypeError, ValueError):
            raise InvalidRequest(f"{text[:60]!r} is not a footprint: give {FORM}", field="footprint") from None

    def samples(self, spacing: float) -> Points:
        """Return points (n, 2), metres, robot frame, that cover the outline and what is in it.

        Args:
            spacing: Largest distance between neighbours, metres. For a circle there are none.
        """
        if not self.corners:
            return np.empty((0, 2))
        outline = np.array(self.corners)
        edges = [
            _between(begin, end, spacing) for begin, end in zip(outline, np.roll(outline, -1, axis=0), strict=True)
        ]
        across = np.arange(-self.circumscribed, self.circumscribed + spacing, spacing)
        grid = np.stack(np.meshgrid(across, across), axis=-1).reshape(-1, 2)
        shape = outline.astype(np.float32)
        inner = [each for each in grid if cv2.pointPolygonTest(shape, (float(each[0]), float(each[1])), False) > 0]
        return np.ascontiguousarray(np.concatenate([*edges, np.array(inner).reshape(-1, 2)]))


def _between(begin: NDArray[np.float64], end: NDArray[np.float64], spacing: float) -> Points:
    """Return points from `begin` up to but without `end`."""
    count = max(1, math.ceil(math.dist(begin, end) / spacing))
    points: Points = begin + np.arange(count)[:, None] / count * (end - begin)
    return points
