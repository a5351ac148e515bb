"""Features of an image with depth: points that are found again from another side, and their places in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rce.mapping3d.camera import Camera
from rce.mapping3d.frames import RgbdFrame

MAX_FEATURES = 600
DESCRIPTOR_BYTES = 32
CELLS = (4, 3)  # the image is divided into so many columns and rows, from each of which features are taken


@dataclass(frozen=True, slots=True)
class Features:
    """Features of an image.

    Attributes:
        pixels: (n, 2) float32 column, row.
        descriptors: (n, 32) uint8 of ORB (Rublee et al., ORB: an efficient alternative to SIFT or SURF, 2011).
        points: (n, 3) float32, frame of the camera, metres; NaN where there is no depth.
    """

    pixels: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    points: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.pixels)


def find_features(frame: RgbdFrame, camera: Camera) -> Features:
    """Return the strongest features, spread over the image."""
    gray = cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY)
    detector = cv2.ORB.create(nfeatures=4 * MAX_FEATURES, fastThreshold=7, edgeThreshold=16, patchSize=31)
    chosen = _spread(detector.detect(gray, None), camera)
    if not chosen:
        return Features(np.empty((0, 2), np.float32), np.empty((0, 32), np.uint8), np.empty((0, 3), np.float32))
    kept, descriptors = detector.compute(gray, chosen)
    pixels = np.array([each.pt for each in kept], np.float32).reshape(-1, 2)
    columns, rows = np.round(pixels).astype(np.int64).T
    points = camera.rays()[rows, columns] * _depth_around(frame, rows, columns)[:, None]
    return Features(pixels, np.asarray(descriptors, np.uint8).reshape(-1, DESCRIPTOR_BYTES), points)


def _spread(found: Sequence[cv2.KeyPoint], camera: Camera) -> list[cv2.KeyPoint]:
    """Return at most `MAX_FEATURES` of the features, the strongest of each cell of the image."""
    columns, rows = CELLS
    cells: dict[tuple[int, int], list[cv2.KeyPoint]] = {}
    for each in found:
        cell = int(each.pt[0] * columns / camera.width), int(each.pt[1] * rows / camera.height)
        cells.setdefault(cell, []).append(each)
    share = MAX_FEATURES // (columns * rows)
    chosen: list[cv2.KeyPoint] = []
    rest: list[cv2.KeyPoint] = []
    for members in cells.values():
        members.sort(key=lambda each: each.response, reverse=True)
        chosen += members[:share]
        rest += members[share:]
    rest.sort(key=lambda each: each.response, reverse=True)
    return chosen + rest[: MAX_FEATURES - len(chosen)]


def _depth_around(frame: RgbdFrame, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return the depth (n,) at pixels, or the nearest depth beside them where it has a hole; NaN without any.

    Features lie on edges, where depth images have holes; of the surfaces at an edge, the near one has the edge.
    """
    height, width = frame.depth.shape
    around = np.stack(
        [
            frame.depth[np.clip(rows + i, 0, height - 1), np.clip(columns + k, 0, width - 1)]
            for i in (-1, 0, 1)
            for k in (-1, 0, 1)
        ]
    )
    near = np.where(around > 0, around, np.float32(np.inf)).min(axis=0)
    own = frame.depth[rows, columns]
    depth: NDArray[np.float32] = np.where(own > 0, own, np.where(np.isfinite(near), near, np.float32(np.nan)))
    return depth
