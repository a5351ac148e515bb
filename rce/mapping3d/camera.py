"""Pinhole camera: from pixels with depth to points, and back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Depth = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Camera:
    """Intrinsics of a camera without distortion.

    Attributes:
        width: Pixels.
        height: Pixels.
        fx: Focal length, pixels.
        fy: Focal length, pixels.
        cx: Column of the optical axis, pixels; 0 is the centre of the first column.
        cy: Row of the optical axis, pixels.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @property
    def numbers(self) -> tuple[int, int, float, float, float, float]:
        """Width, height, fx, fy, cx, cy as plain numbers, whatever NumPy made of them."""
        return int(self.width), int(self.height), float(self.fx), float(self.fy), float(self.cx), float(self.cy)

    @property
    def matrix(self) -> Floats:
        """The (3, 3) matrix that takes points in the frame of the camera to homogeneous pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def scaled(self, factor: float) -> Camera:
        """Return the camera of images resized by this factor, for example 0.5 from VGA to QVGA."""
        return Camera(
            round(self.width * factor),
            round(self.height * factor),
            self.fx * factor,
            self.fy * factor,
            (self.cx + 0.5) * factor - 0.5,
            (self.cy + 0.5) * factor - 0.5,
        )

    def rays(self) -> Depth:
        """Return (height, width, 3) float32: the point that each pixel sees at a depth of 1 m. Do not change it."""
        return _rays(self)

    def points(self, depth: Depth) -> Depth:
        """Return (height, width, 3) float32 points in the frame of the camera; zeros where there is no depth.

        Args:
            depth: (height, width) float32, metres along the optical axis, 0 = none.
        """
        points: Depth = self.rays() * depth[:, :, None]
        return points

    def project(self, points: NDArray[np.floating]) -> Floats:
        """Return pixels (n, 2) of points (n, 3), frame of the camera. A point at or behind the camera gives NaN."""
        front = np.where(points[:, 2] > 0, points[:, 2], math.nan).astype(np.float64)
        return np.stack([self.fx * points[:, 0] / front + self.cx, self.fy * points[:, 1] / front + self.cy], axis=1)


@lru_cache(maxsize=8)
def _rays(camera: Camera) -> Depth:
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    columns, rows = np.meshgrid(x, y)
    rays = np.stack([columns, rows, np.ones_like(columns)], axis=2).astype(np.float32)
    rays.setflags(write=False)
    return rays
