"""The images of key frames, packed, so that they can be taken out of the map and put in elsewhere."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from rce.mapping3d.camera import Camera, Depth
from rce.mapping3d.dense.volume import without_edges
from rce.mapping3d.frames import Image, KeyFrame
from rce.mapping3d.poses import Pose, angle, distance, inverse

WIDTH = 320  # pixels; at 3 m a pixel is 1 cm wide then
STEP = 4  # every fourth pixel in both directions is enough for rays through free space
MILLIMETRE = 0.001
QUALITY = 90  # of JPEG
ARM = 2.0  # metres: how far from the camera a turn of it moves what it sees


class KeptFrame:
    """A key frame in the map.

    Attributes:
        robot: As in `KeyFrame`.
        index: As in `KeyFrame`.
        camera: Of the kept images.
        pose: Camera to map, at which the images are in the volume.
        wanted: Camera to map, at which they should be.
        points: (n, 3) float32, metres, frame of the camera: some of the points that it sees.
    """

    def __init__(self, key_frame: KeyFrame, pose: Pose, max_depth: float) -> None:
        """Reduce and pack the images of a key frame. Depths are rounded to millimetres.

        Args:
            key_frame: The images. Those wider than 320 pixels are reduced.
            pose: (4, 4) camera to map.
            max_depth: Metres.
        """
        self.robot, self.index = key_frame.robot, key_frame.index
        self.pose = self.wanted = pose.copy()
        frame, camera = key_frame.frame, key_frame.camera
        step = max(1, round(camera.width / WIDTH))
        depth = np.ascontiguousarray(without_edges(frame.depth, max_depth)[::step, ::step])
        height, width = depth.shape
        # Depths are picked, not averaged: every step-th pixel keeps its place, so only the units change.
        self.camera = Camera(width, height, camera.fx / step, camera.fy / step, camera.cx / step, camera.cy / step)
        color = cv2.resize(frame.color, (width, height), interpolation=cv2.INTER_AREA) if step > 1 else frame.color
        millimetres = np.minimum(np.rint(depth / MILLIMETRE), 65535).astype(np.uint16)
        self._depth = cv2.imencode(".png", millimetres, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1]
        self._color = cv2.imencode(".jpg", color[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]
        points = self.camera.points(depth)[::STEP, ::STEP].reshape(-1, 3)
        self.points: NDArray[np.float32] = points[points[:, 2] > 0]

    def images(self) -> tuple[Depth, Image]:
        """Return depth (height, width) float32, metres, and colour (height, width, 3); the same at each call."""
        millimetres = cv2.imdecode(self._depth, cv2.IMREAD_UNCHANGED)
        color = cv2.imdecode(self._color, cv2.IMREAD_COLOR)
        assert millimetres is not None  # it is from the encoder above
        assert color is not None
        depth = millimetres.astype(np.float32) * np.float32(MILLIMETRE)
        return depth, np.asarray(cv2.cvtColor(color, cv2.COLOR_BGR2RGB), np.uint8)

    def offset(self) -> float:
        """Return by how much what the frame sees is out of its place, metres."""
        return apart(self.pose, self.wanted)


def apart(first: Pose, second: Pose) -> float:
    """Return by how much what a camera sees moves between two poses, metres."""
    way = inverse(first) @ second
    return distance(way) + ARM * angle(way)
