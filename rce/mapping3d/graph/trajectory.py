"""Poses of all frames of a robot, from the poses of its key frames."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rce.mapping3d.files.trajectories import Stamped
from rce.mapping3d.odometry.tracker import Tracked
from rce.mapping3d.poses import Pose, interpolate


class Trajectory:
    """Frames of one robot: each has a key frame and a pose relative to it, so corrections of the map reach it."""

    def __init__(self) -> None:
        """Begin without frames."""
        self._frames: list[tuple[float, int, Pose, bool]] = []

    def __len__(self) -> int:
        return len(self._frames)

    def add(self, tracked: Tracked) -> None:
        """Add a frame."""
        if tracked.key is not None:  # it is its own reference: it stays right when the key frames move apart
            self._frames.append((tracked.stamp, tracked.key.index, np.eye(4), False))
        else:
            self._frames.append((tracked.stamp, tracked.reference, tracked.pose, tracked.lost))

    def poses(self, key_pose: Callable[[int], Pose]) -> list[Stamped]:
        """Return the poses of all frames, frame of the map. Those of frames without track are interpolated.

        Args:
            key_pose: Returns the pose of the key frame of an index, frame of the map.
        """
        known = [
            (stamp, key_pose(index) @ pose) for stamp, index, pose, lost in self._frames if index >= 0 and not lost
        ]
        if not known:
            return []
        stamps = np.array([stamp for stamp, _ in known])
        result = []
        position = 0
        for stamp, index, _, lost in self._frames:
            if index >= 0 and not lost:
                result.append(known[position])
                position += 1
                continue
            after = int(np.clip(np.searchsorted(stamps, stamp), 1, max(len(known) - 1, 1)))
            first, second = known[after - 1], known[min(after, len(known) - 1)]
            share = (stamp - first[0]) / (second[0] - first[0]) if second[0] > first[0] else 0.0
            result.append((stamp, interpolate(first[1], second[1], float(np.clip(share, 0.0, 1.0)))))
        return result
