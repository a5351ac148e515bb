"""Moving images of a camera, made by tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def color(number: int, width: int = 96, height: int = 72) -> NDArray[np.uint8]:
    """Return an image (height, width, 3) of a smooth pattern that moves."""
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    waves = [np.sin((columns + 2 * number) / 9), np.sin(rows / 7), np.sin((columns + rows + number) / 11)]
    return np.stack([128 + 100 * wave for wave in waves], axis=2).astype(np.uint8)


def noise(number: int, width: int = 96, height: int = 72) -> NDArray[np.uint8]:
    """Return an image (height, width, 3) that no encoder makes small."""
    return np.random.default_rng(number).integers(0, 256, (height, width, 3), dtype=np.uint8)


def depth(number: int, width: int = 96, height: int = 72) -> NDArray[np.uint16]:
    """Return an image (height, width) as of structured light: distances of whole disparities, and holes."""
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    millimetres = 1000 + 5 * columns + 20 * np.sin((rows + number) / 5)
    disparity = np.rint(8 * 580 * 75 / millimetres)
    holes = (columns + number) % 17 == 0
    return np.where(holes, 0, 8 * 580 * 75 / disparity).astype(np.uint16)
