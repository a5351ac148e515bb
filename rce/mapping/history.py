"""The poses of all scans, each fixed to a node of the graph (or another pose that may still be corrected)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rce.mapping.geometry import Pose
from rce.mapping.state import Reader, State


class History:
    """Grows by one row a scan: stamp, x, y, theta in the frame of a node (40 bytes with its number)."""

    def __init__(self) -> None:
        self._count = 0
        self._rows = np.empty((1024, 4))
        self._nodes = np.empty(1024, np.int64)

    def __len__(self) -> int:
        return self._count

    def append(self, stamp: float, node: int, relative: Pose) -> None:
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
            self._nodes = np.concatenate([self._nodes, np.empty_like(self._nodes)])
        self._rows[self._count] = stamp, *relative
        self._nodes[self._count] = node
        self._count += 1

    def at(self, stamp: float) -> tuple[int, Pose]:
        """Node and relative pose of the last scan that is not after `stamp` (of the first one if all are)."""
        row = max(int(np.searchsorted(self._rows[: self._count, 0], stamp, side="right")) - 1, 0)
        return int(self._nodes[row]), Pose(*self._rows[row, 1:].tolist())

    def state(self) -> State:
        return {"rows": self._rows[: self._count].copy(), "nodes": self._nodes[: self._count].copy()}

    def restore(self, saved: Reader, nodes: int) -> None:
        """`nodes`: how many there are."""
        rows = saved.array("rows", np.float64, None, 4)
        self._count, self._rows = len(rows), np.concatenate([rows, np.empty((1024, 4))])
        self._nodes = np.concatenate([saved.indices("nodes", nodes, len(rows)), np.empty(1024, np.int64)])

    def trajectory(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 4) stamp, x, y, theta in the frame in which the poses (nodes, 3) of all nodes are given."""
        rows = self._rows[: self._count].copy()
        rows[:, 1:] = _compose(poses[self._nodes[: self._count]], rows[:, 1:])
        return rows


def _compose(frames: NDArray[np.float64], poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Poses (n, 3), given in `frames` (n, 3), in the frame in which those are given."""
    c, s = np.cos(frames[:, 2]), np.sin(frames[:, 2])
    x = frames[:, 0] + c * poses[:, 0] - s * poses[:, 1]
    y = frames[:, 1] + s * poses[:, 0] + c * poses[:, 1]
    theta: NDArray[np.float64] = frames[:, 2] + poses[:, 2]
    return np.stack([x, y, (theta + np.pi) % (2 * np.pi) - np.pi], axis=1)
