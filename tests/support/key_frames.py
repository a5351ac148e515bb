"""Key frames of a robot as they travel, without a camera."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rce.mapping3d.evaluation.room import QVGA
from rce.mapping3d.frames import KeyFrame, RgbdFrame
from rce.mapping3d.odometry.tracker import Tracked
from rce.mapping3d.offload.messages import KeyFrameMessage, message_of
from rce.mapping3d.poses import make_pose

BLANK = RgbdFrame(0.0, np.zeros((240, 320, 3), np.uint8), np.full((240, 320), 2.0, np.float32))


def right(metres: float) -> NDArray[np.float64]:
    return make_pose(np.eye(3), (metres, 0.0, 0.0))


def tracked(index: int, way: float = 0.1, linked: bool = True, frame: RgbdFrame = BLANK) -> Tracked:
    """Return the key frame `index`, that many metres to the right of the one before."""
    moved = RgbdFrame(float(index), frame.color, frame.depth)
    key = KeyFrame(0, index, moved, QVGA)
    return Tracked(float(index), index - 1, right(way), 1e4 * np.eye(6), key=key, linked=linked and index > 0)


def key_frame(index: int, way: float = 0.1, linked: bool = True, run: str = "run") -> KeyFrameMessage:
    return message_of(run, tracked(index, way, linked))
