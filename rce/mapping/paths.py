"""The ways that particles think the robot has gone, with what they have in common stored once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rce.mapping.state import Reader, State

Array = NDArray[np.float64]


class Paths:
    """`count` paths of poses. Resampling makes most of them grow out of one stem, which is all that is left of them
    in the long run (Doucet et al., Rao-Blackwellised Particle Filtering, 2000)."""

    def __init__(self, count: int) -> None:
        self.stem = np.empty((0, 3))  # x, y, theta, metres and radians, map frame; of all particles
        self.open = np.empty((count, 0, 3))  # where they differ

    def __len__(self) -> int:
        """Poses of a path."""
        return len(self.stem) + self.open.shape[1]

    def append(self, poses: Array) -> None:
        """`poses`: (count, 3), the next one of each path."""
        self.open = np.concatenate([self.open, poses[:, None]], axis=1)

    def resample(self, parents: NDArray[np.int64]) -> None:
        """Replace path i by that of `parents[i]`."""
        self.open = self.open[parents]
        same = (self.open == self.open[:1]).all(axis=(0, 2))
        common = len(same) if same.all() else int(np.argmin(same))
        self.stem = np.concatenate([self.stem, self.open[0, :common]])
        self.open = np.ascontiguousarray(self.open[:, common:])

    def state(self) -> State:
        return {"stem": self.stem.copy(), "open": self.open.copy()}

    def restore(self, saved: Reader) -> None:
        self.stem = saved.array("stem", np.float64, None, 3)
        self.open = saved.array("open", np.float64, len(self.open), None, 3)

    def of(self, particle: int) -> Array:
        """The path (n, 3) of a particle."""
        return np.concatenate([self.stem, self.open[particle]])
