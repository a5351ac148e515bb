"""An image with depth at several sizes, prepared for alignment as image or as reference."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rce.mapping3d.camera import Camera, Depth
from rce.mapping3d.frames import RgbdFrame
from rce.mapping3d.odometry.kernels import fill_normals

LEVELS = 4  # QVGA to 40 x 30
MIN_GRADIENT = 3.0  # of brightness, a pixel; below it the brightness says nothing about the motion
FULL_POINTS = 160 * 120  # of a reference at most; a larger level is thinned out to this many
MAX_RANGE = 6.0  # metres; beyond it depths of structured light are hardly better than none


@dataclass(frozen=True, slots=True)
class Level:
    """An image at one size.

    Attributes:
        camera: The camera of this size.
        image: (height, width) float32 brightness, 0 to 255.
        depth: (height, width) float32, metres, 0 = none.
    """

    camera: Camera
    image: NDArray[np.float32]
    depth: Depth


@dataclass(frozen=True, slots=True)
class ReferenceLevel:
    """Points of a reference at one size.

    Attributes:
        points: (n, 3) float32, frame of the camera.
        normals: (n, 3) float32 unit normals, zeros where unknown.
        brightness: (n,) float32, 0 to 255; -1 where the image is even and only the depth counts.
    """

    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    brightness: NDArray[np.float32]


def image_pyramid(frame: RgbdFrame, camera: Camera) -> list[Level]:
    """Return the image at full size, half of it, and so on."""
    gray = cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY)
    image = np.asarray(gray, np.float32)
    depth = np.where(frame.depth <= MAX_RANGE, frame.depth, np.float32(0))
    levels = [Level(camera, image, depth)]
    while len(levels) < LEVELS:
        last = levels[-1]
        height, width = last.depth.shape
        small = cv2.resize(last.image, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
        levels.append(Level(last.camera.scaled(0.5), np.asarray(small, np.float32), _halved(last.depth)))
    return levels


def reference_pyramid(levels: list[Level]) -> list[ReferenceLevel]:
    """Return the points of an image at each size, for alignment with later images."""
    return [_reference(level) for level in levels]


def _reference(level: Level) -> ReferenceLevel:
    grid = level.camera.points(level.depth)
    normals = np.empty_like(grid)
    fill_normals(np.ascontiguousarray(grid), normals)
    gx = cv2.Sobel(level.image, cv2.CV_32F, 1, 0, scale=0.125)
    gy = cv2.Sobel(level.image, cv2.CV_32F, 0, 1, scale=0.125)
    strength = np.maximum(np.abs(gx), np.abs(gy))
    textured = strength >= MIN_GRADIENT
    useful = (level.depth > 0) & (textured | normals.any(axis=2))
    chosen = np.flatnonzero(useful)
    if len(chosen) > FULL_POINTS:  # spread evenly over the image
        chosen = chosen[np.linspace(0, len(chosen) - 1, FULL_POINTS).astype(np.int64)]
    brightness = np.where(textured, level.image, np.float32(-1)).ravel()[chosen]
    return ReferenceLevel(
        np.ascontiguousarray(grid.reshape(-1, 3)[chosen]),
        np.ascontiguousarray(normals.reshape(-1, 3)[chosen]),
        np.ascontiguousarray(brightness, np.float32),
    )


def _halved(depth: Depth) -> Depth:
    """Return the depth at half the size: of each four pixels the second nearest that is measured, no mixture."""
    height, width = depth.shape
    quads = depth[: height // 2 * 2, : width // 2 * 2].reshape(height // 2, 2, width // 2, 2)
    far = np.where(quads > 0, quads, np.float32(1e9))
    nearest: Depth = far.min(axis=(1, 3))
    return np.where(nearest < 1e9, nearest, np.float32(0))
