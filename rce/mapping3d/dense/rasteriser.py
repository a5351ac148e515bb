"""Draws coloured triangles seen from far away, in parallel projection."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rce.mapping.matching.kernels import compiled


@compiled("void(float32[:,:,::1], float32[:,::1], float64[:,::1], float32[:,::1], int32[:,::1])")
def draw_triangles(
    image: NDArray[np.float32],
    nearest: NDArray[np.float32],
    corners: NDArray[np.float64],
    colors: NDArray[np.float32],
    triangles: NDArray[np.int32],
) -> None:
    """Draw the triangles whose corners run clockwise on the image; the others are seen from behind and left out.

    Colours between the corners are interpolated (Gouraud, 1971), the nearest surface wins (Catmull's z-buffer, 1974).

    Args:
        image: (height, width, 3), changed in place.
        nearest: (height, width) distance of what is drawn, changed in place; begins with infinity.
        corners: (n, 3) column, row, distance; pixel (0, 0) has its centre at (0, 0).
        colors: (n, 3) of the corners.
        triangles: (m, 3) corners.
    """
    height, width = nearest.shape
    for m in range(triangles.shape[0]):
        a, b, c = triangles[m]
        ax, ay, bx, by, cx, cy = (
            corners[a, 0],
            corners[a, 1],
            corners[b, 0],
            corners[b, 1],
            corners[c, 0],
            corners[c, 1],
        )
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area >= 0.0:  # rows grow downwards: what is counter-clockwise in space has a negative area here
            continue
        left, right = max(0, int(np.ceil(min(ax, bx, cx)))), min(width - 1, int(np.floor(max(ax, bx, cx))))
        top, bottom = max(0, int(np.ceil(min(ay, by, cy)))), min(height - 1, int(np.floor(max(ay, by, cy))))
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                u = ((bx - column) * (cy - row) - (by - row) * (cx - column)) / area
                v = ((cx - column) * (ay - row) - (cy - row) * (ax - column)) / area
                w = 1.0 - u - v
                if u < 0.0 or v < 0.0 or w < 0.0:
                    continue
                distance = u * corners[a, 2] + v * corners[b, 2] + w * corners[c, 2]
                if distance < nearest[row, column]:
                    nearest[row, column] = distance
                    for k in range(3):
                        image[row, column, k] = u * colors[a, k] + v * colors[b, k] + w * colors[c, k]
