"""Key frames that look alike: Scan Context.

Kim and Kim, Scan Context: Egocentric Spatial Descriptor for Place Recognition within 3D Point Cloud Map, 2018. They
keep the height of the highest point of each cell, which under a ceiling is that of the ceiling everywhere. Here it is
the number of points on upright planes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping3d.lidar.registration import Surface

UPRIGHT = 0.5  # largest upward part of the normal of a wall


@dataclass(frozen=True, slots=True)
class ContextSettings:
    """Shape of a descriptor.

    Attributes:
        rings: Number of rings.
        sectors: Number of sectors.
        furthest: Outer radius, metres.
    """

    rings: int = 20
    sectors: int = 60
    furthest: float = 20.0


SETTINGS = ContextSettings()
Descriptor = NDArray[np.float64]  # (rings, sectors), of length 1


def descriptor(surface: Surface, settings: ContextSettings = SETTINGS) -> Descriptor:
    """Return the descriptor of a cloud around its lidar, whose z axis is nearly upright."""
    upright = np.abs(surface.normals[:, 2]) < UPRIGHT
    x, y = surface.points[upright, 0], surface.points[upright, 1]
    ranges = np.hypot(x, y)
    inside = ranges < settings.furthest
    rings = (ranges[inside] / settings.furthest * settings.rings).astype(np.int64)
    sectors = ((np.arctan2(y, x)[inside] / (2 * math.pi) + 0.5) * settings.sectors).astype(np.int64) % settings.sectors
    cells = np.bincount(rings * settings.sectors + sectors, minlength=settings.rings * settings.sectors)
    values = np.log1p(cells.reshape(settings.rings, settings.sectors))
    # A wall beside the line between two cells counts in both, so that small shifts do not matter.
    smooth = values + 0.5 * (np.roll(values, 1, axis=1) + np.roll(values, -1, axis=1))
    smooth[1:] += 0.5 * values[:-1]
    smooth[:-1] += 0.5 * values[1:]
    length = np.linalg.norm(smooth)
    found: Descriptor = smooth / length if length else smooth
    return found


class ContextIndex:
    """Index of key frames by their descriptors: 20 kB each."""

    def __init__(self, settings: ContextSettings = SETTINGS) -> None:
        """Create an empty index."""
        self._settings = settings
        self._numbers: list[int] = []
        self._spectra: list[NDArray[np.complex64]] = []  # along the sectors

    def __len__(self) -> int:
        return len(self._numbers)

    def add(self, number: int, found: Descriptor) -> None:
        """Add a key frame."""
        self._numbers.append(number)
        self._spectra.append(np.fft.rfft(found, axis=1).astype(np.complex64))

    def query(self, wanted: Descriptor) -> list[tuple[int, float, float]]:
        """Return number, similarity from 0 to 1 and yaw of each key frame, the most similar first.

        The yaw is that of the lidar that `wanted` is of, in the frame of the key frame, radians. All shifts of sectors
        are compared at once, in the frequency domain.
        """
        if not self._numbers:
            return []
        spectrum = np.conj(np.fft.rfft(wanted, axis=1))
        products = np.stack([(each * spectrum).sum(axis=0) for each in self._spectra])
        similar = np.fft.irfft(products, self._settings.sectors, axis=1)
        shifts = similar.argmax(axis=1)
        scores = similar[np.arange(len(shifts)), shifts]
        yaws = 2 * math.pi * shifts / self._settings.sectors
        order = np.argsort(-scores)
        return [(self._numbers[i], float(scores[i]), float(yaws[i])) for i in order.tolist()]
