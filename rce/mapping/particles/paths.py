"""Paths of the particles, whose common part is stored once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rce.mapping.state import Reader, State

Array = NDArray[np.float64]


class Paths:
    """Paths of poses, one for each particle.

    Resampling makes most paths descend from a single ancestor, so that in the long run they differ only in their last
    part (Doucet et al., Rao-Blackwellised Particle Filtering for Dynamic Bayesian Networks, 2000).

    Attributes:
        stem: (n, 3) x, y, theta, metres and radians, map frame: the part that all paths have in common.
        branches: (count, m, 3), the part in which they differ.
    """

    def __init__(self, count: int, stem: Array | None = None) -> None:
        """Make `count` paths with the poses (n, 3) of a stem; None makes them empty."""
        self.stem = np.empty((0, 3)) if stem is None else stem
        self.branches = np.empty((count, 0, 3))

    def __len__(self) -> int:
        """Return the number of poses of each path."""
        return len(self.stem) + self.branches.shape[1]

    def append(self, poses: Array) -> None:
        """Append the next pose of each path, (count, 3)."""
        self.branches = np.concatenate([self.branches, poses[:, None]], axis=1)

    def resample(self, parents: NDArray[np.int64]) -> None:
        """Replace each path i by the path `parents[i]`, and move what all have in common to the stem."""
        self.branches = self.branches[parents]
        same = (self.branches == self.branches[:1]).all(axis=(0, 2))
        common = len(same) if same.all() else int(np.argmin(same))
        self.stem = np.concatenate([self.stem, self.branches[0, :common]])
        self.branches = np.ascontiguousarray(self.branches[:, common:])

    def state(self) -> State:
        """Return the paths as arrays to save."""
        return {"stem": self.stem.copy(), "open": self.branches.copy()}

    def restore(self, saved: Reader) -> None:
        """Replace the paths by saved ones.

        Raises:
            InvalidRequest: The saved arrays are not paths of as many particles.
        """
        self.stem = saved.array("stem", np.float64, None, 3)
        self.branches = saved.array("open", np.float64, len(self.branches), None, 3)

    def path(self, particle: int) -> Array:
        """Return the path (n, 3) of a particle."""
        return np.concatenate([self.stem, self.branches[particle]])
