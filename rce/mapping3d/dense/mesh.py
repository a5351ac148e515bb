"""A surface as coloured triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vertices = NDArray[np.float32]  # (n, 3), metres


@dataclass(frozen=True, slots=True)
class Cloud:
    """Points of a surface.

    Attributes:
        points: (n, 3) float32, metres, map frame.
        normals: (n, 3) float32, unit vectors out of the surface; zeros where there is none.
        colors: (n, 3) uint8, red, green, blue.
    """

    points: Vertices
    normals: Vertices
    colors: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Mesh:
    """A surface.

    Attributes:
        cloud: The corners of the triangles.
        triangles: (m, 3) int32, indices of the corners, counter-clockwise seen from the free side.
    """

    cloud: Cloud
    triangles: NDArray[np.int32]
