"""Images with depth, and clouds: the records that recordings and sensors produce and the mapper consumes."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rce.mapping3d.camera import Camera, Depth

Image = NDArray[np.uint8]

MAX_WIDTH = 400  # pixels; wider images are halved until they are narrower: the front end works on QVGA
SAME_SURFACE = np.float32(1.03)  # neighbouring pixels of one surface differ less in depth, as a ratio


@dataclass(frozen=True, slots=True)
class RgbdFrame:
    """A colour image and the depth image of the same moment, of the same camera and size.

    Attributes:
        stamp: Seconds.
        color: (height, width, 3) uint8, red, green, blue.
        depth: (height, width) float32, metres along the optical axis, 0 = none.
    """

    stamp: float
    color: Image
    depth: Depth

    def halved(self) -> RgbdFrame:
        """Return the frame at half its width and height, as `Camera.scaled(0.5)` sees it.

        Colours are averaged. Depths are too, but only those near the closest of their four pixels: an average across an
        edge would be a point in the air.
        """
        height, width = self.depth.shape
        color = np.asarray(cv2.resize(self.color, (width // 2, height // 2), interpolation=cv2.INTER_AREA), np.uint8)
        squares = self.depth[: height // 2 * 2, : width // 2 * 2].reshape(height // 2, 2, width // 2, 2)
        blocks = squares.transpose(1, 3, 0, 2).reshape(4, height // 2, width // 2)
        nearest = np.where(blocks > 0, blocks, np.inf).min(axis=0)
        used = (blocks > 0) & (blocks <= SAME_SURFACE * nearest)
        count = used.sum(axis=0, dtype=np.float32)
        total = np.where(used, blocks, np.float32(0)).sum(axis=0, dtype=np.float32)
        depth = total / np.maximum(count, np.float32(1))
        return RgbdFrame(self.stamp, color, depth.astype(np.float32, copy=False))


@dataclass(frozen=True, slots=True)
class KeyFrame:
    """A frame that the front end keeps for the map.

    Attributes:
        robot: Number of the robot, from 0.
        index: Number of the frame among the key frames of this robot, from 0.
        frame: The images.
        camera: The camera of these images.
    """

    robot: int
    index: int
    frame: RgbdFrame
    camera: Camera


@dataclass(frozen=True, slots=True)
class CloudKeyFrame:
    """Points of a lidar that the front end keeps for the map.

    Attributes:
        robot: Number of the robot, from 0.
        index: Number among the key frames of this robot, from 0.
        stamp: Seconds.
        points: (n, 3) float32, metres, frame of the lidar at `stamp`.
    """

    robot: int
    index: int
    stamp: float
    points: NDArray[np.float32]


AnyKeyFrame = KeyFrame | CloudKeyFrame


def reduced_camera(camera: Camera) -> Camera:
    """Return the camera of frames after `reduced`."""
    while camera.width > MAX_WIDTH:
        camera = camera.scaled(0.5)
    return camera


def reduced(frame: RgbdFrame) -> RgbdFrame:
    """Return a frame at the size that the front end works on."""
    while frame.depth.shape[1] > MAX_WIDTH:
        frame = frame.halved()
    return frame
