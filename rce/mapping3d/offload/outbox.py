"""Key frames that the cloud does not have yet, within bounds of memory."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rce.mapping3d.offload.messages import KeyFrameMessage, information_of, pose_of, rebased, unlinked
from rce.mapping3d.poses import Pose, angle, distance

Floats = NDArray[np.float64]

METRES, RADIANS = 0.09, math.radians(3.0)  # motions that count alike
WEAKEST = 1e-2  # information of a direction that was not measured, so that the sum of covariances exists


class Outbox:
    """Key frames in order, from the oldest that was not acknowledged.

    When they take too much memory, those with the least motion to their neighbours are left out, and the motions on
    both sides become one. So the way stays connected, and becomes coarser.

    Attributes:
        left_out: Number of key frames that were left out.
    """

    def __init__(self, most: int) -> None:
        """Begin empty; keep at most this many bytes of images or points."""
        self.left_out = 0
        self._most = most
        self._waiting: dict[int, KeyFrameMessage] = {}  # by index, in order

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def size(self) -> int:
        """Bytes of the images or points that wait."""
        return sum(_size(message) for message in self._waiting.values())

    def add(self, message: KeyFrameMessage) -> None:
        """Add the newest key frame."""
        self._waiting[message.index] = message
        size = self.size
        while size > self._most and len(self._waiting) > 2:
            size -= self._leave_out()

    def acknowledge(self, index: int) -> None:
        """Forget a key frame that the cloud has."""
        self._waiting.pop(index, None)

    def after(self, index: int) -> KeyFrameMessage | None:
        """Return the oldest key frame with a larger index, None if there is none."""
        return next((message for each, message in self._waiting.items() if each > index), None)

    def _leave_out(self) -> int:
        """Leave out the key frame with the least motion around it, never the newest; return its size."""
        messages = list(self._waiting.values())
        inner = [
            (_way(first) + _way(second), first, second)
            for first, second in pairwise(messages)
            if first.linked and second.linked and second.reference == first.index
        ]
        if inner:
            _, dropped, following = min(inner, key=lambda each: each[0])
            together = joined(information_of(dropped), information_of(following), pose_of(following))
            self._waiting[following.index] = rebased(following, dropped, together)
        else:
            dropped, following = messages[0], messages[1]
            self._waiting[following.index] = unlinked(following)
        del self._waiting[dropped.index]
        self.left_out += 1
        return _size(dropped)


def joined(first: Floats, second: Floats, pose: Pose) -> Floats:
    """Return the information (6, 6) of two motions after each other, in the frame of the camera after the second.

    Args:
        first: (6, 6) inverse covariance of the first motion: translation, rotation, frame of the camera after it.
        second: (6, 6) the same of the second motion.
        pose: (4, 4) the second motion: camera after it to camera before it.
    """
    weakest = WEAKEST * np.eye(6)
    turned = pose[:3, :3].T
    shift = -turned @ pose[:3, 3]
    cross = np.array([[0.0, -shift[2], shift[1]], [shift[2], 0.0, -shift[0]], [-shift[1], shift[0], 0.0]])
    adjoint = np.block([[turned, cross @ turned], [np.zeros((3, 3)), turned]])
    total = adjoint @ np.linalg.inv(first + weakest) @ adjoint.T + np.linalg.inv(second + weakest)
    inverse: Floats = np.linalg.inv(total)
    return 0.5 * (inverse + inverse.T)


def _way(message: KeyFrameMessage) -> float:
    pose = pose_of(message)
    return distance(pose) / METRES + angle(pose) / RADIANS


def _size(message: KeyFrameMessage) -> int:
    return len(message.color) + len(message.depth) + len(message.cloud)
