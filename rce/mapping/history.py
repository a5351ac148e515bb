"""Poses of all scans, each relative to a node of the graph or another pose that may still be corrected."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Pose, wrap_angles
from rce.mapping.state import Reader, State

FIRST_ROWS = 1024  # rows allocated at first; the arrays double when they are full


class History:
    """Growing table with one row a scan: stamp, x, y, theta in the frame of a node, and the node (40 bytes)."""

    def __init__(self) -> None:
        """Make an empty history."""
        self._count = 0
        self._rows = np.empty((FIRST_ROWS, 4))
        self._nodes = np.empty(FIRST_ROWS, np.int64)

    def __len__(self) -> int:
        """Return the number of scans."""
        return self._count

    def append(self, stamp: float, node: int, relative: Pose) -> None:
        """Add a scan, later than all others, by its pose in the frame of a node."""
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
            self._nodes = np.concatenate([self._nodes, np.empty_like(self._nodes)])
        self._rows[self._count] = stamp, *relative
        self._nodes[self._count] = node
        self._count += 1

    def at(self, stamp: float) -> tuple[int, Pose]:
        """Return node and relative pose of the last scan not after `stamp`, or of the first scan if all are later."""
        row = max(int(np.searchsorted(self._rows[: self._count, 0], stamp, side="right")) - 1, 0)
        return int(self._nodes[row]), Pose(*self._rows[row, 1:].tolist())

    def state(self) -> State:
        """Return the history as arrays to save."""
        return {"rows": self._rows[: self._count].copy(), "nodes": self._nodes[: self._count].copy()}

    def restore(self, saved: Reader, nodes: int) -> None:
        """Replace the history by a saved one.

        Args:
            saved: The saved arrays.
            nodes: Number of nodes that exist.

        Raises:
            InvalidRequest: The saved arrays are not a history.
        """
        rows = saved.array("rows", np.float64, None, 4)
        self._count, self._rows = len(rows), np.concatenate([rows, np.empty((FIRST_ROWS, 4))])
        self._nodes = np.concatenate([saved.indices("nodes", nodes, len(rows)), np.empty(FIRST_ROWS, np.int64)])

    def trajectory(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (n, 4) stamp, x, y, theta of all scans.

        Args:
            poses: (nodes, 3) x, y, theta of all nodes; the trajectory is in the same frame.
        """
        rows = self._rows[: self._count].copy()
        rows[:, 1:] = _compose(poses[self._nodes[: self._count]], rows[:, 1:])
        return rows


def _compose(frames: NDArray[np.float64], poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compose two arrays of poses (n, 3) row by row, as `Pose.__matmul__`."""
    c, s = np.cos(frames[:, 2]), np.sin(frames[:, 2])
    x = frames[:, 0] + c * poses[:, 0] - s * poses[:, 1]
    y = frames[:, 1] + s * poses[:, 0] + c * poses[:, 1]
    return np.stack([x, y, wrap_angles(frames[:, 2] + poses[:, 2])], axis=1)
