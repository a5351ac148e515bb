"""Key frames, packed, so that they can be taken out of the map and put in elsewhere."""

from __future__ import annotations

from abc import ABC, abstractmethod

import cv2
import numpy as np
from numpy.typing import NDArray

from rce.mapping3d.camera import Camera, Depth
from rce.mapping3d.dense.volume import Volume, without_edges
from rce.mapping3d.frames import AnyKeyFrame, CloudKeyFrame, Image, KeyFrame
from rce.mapping3d.lidar.registration import Surface
from rce.mapping3d.poses import Pose, angle, distance, inverse

WIDTH = 320  # pixels; at 3 m a pixel is 1 cm wide then
STEP = 4  # every fourth pixel in both directions is enough for rays through free space
MILLIMETRE = 0.001
QUALITY = 90  # of JPEG
ARM = 2.0  # metres: how far from the sensor a turn of it moves what it sees


class Kept(ABC):
    """A key frame in the map.

    Attributes:
        robot: As in the key frame.
        index: As in the key frame.
        pose: Sensor to map, at which the measurements are in the volume.
        wanted: Sensor to map, at which they should be.
        points: (n, 3) float32, metres, frame of the sensor: some of the points that it sees.
    """

    points: NDArray[np.float32]

    def __init__(self, key_frame: AnyKeyFrame, pose: Pose) -> None:
        """Begin at a pose (4, 4), sensor to map."""
        self.robot, self.index = key_frame.robot, key_frame.index
        self.pose = self.wanted = pose.copy()

    @abstractmethod
    def put_into(self, volume: Volume) -> None:
        """Add the measurements to a volume.

        Raises:
            VolumeFull: There is no room for them.
        """

    @abstractmethod
    def take_from(self, volume: Volume) -> None:
        """Take the measurements out of a volume that they were put into at the same pose."""

    def offset(self) -> float:
        """Return by how much what the sensor sees is out of its place, metres."""
        return 0.0 if np.array_equal(self.pose, self.wanted) else apart(self.pose, self.wanted)


class KeptFrame(Kept):
    """A key frame of a camera.

    Attributes:
        camera: Of the kept images.
    """

    def __init__(self, key_frame: KeyFrame, pose: Pose, max_depth: float) -> None:
        """Reduce and pack the images of a key frame. Depths are rounded to millimetres.

        Args:
            key_frame: The images. Those wider than 320 pixels are reduced.
            pose: (4, 4) camera to map.
            max_depth: Metres.
        """
        super().__init__(key_frame, pose)
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
        self.points = points[points[:, 2] > 0]

    def images(self) -> tuple[Depth, Image]:
        """Return depth (height, width) float32, metres, and colour (height, width, 3); the same at each call."""
        millimetres = cv2.imdecode(self._depth, cv2.IMREAD_UNCHANGED)
        color = cv2.imdecode(self._color, cv2.IMREAD_COLOR)
        assert millimetres is not None  # it is from the encoder above
        assert color is not None
        depth = millimetres.astype(np.float32) * np.float32(MILLIMETRE)
        return depth, np.asarray(cv2.cvtColor(color, cv2.COLOR_BGR2RGB), np.uint8)

    def put_into(self, volume: Volume) -> None:
        """Add the images to a volume."""
        volume.add(*self.images(), self.camera, self.pose)

    def take_from(self, volume: Volume) -> None:
        """Take the images out of a volume."""
        volume.remove(*self.images(), self.camera, self.pose)


class KeptCloud(Kept):
    """A key frame of a lidar."""

    def __init__(self, key_frame: CloudKeyFrame, pose: Pose) -> None:
        """Find the planes of the points of a key frame.

        Args:
            key_frame: The points.
            pose: (4, 4) lidar to map.
        """
        super().__init__(key_frame, pose)
        surface = Surface(key_frame.points)
        self._normals = surface.normals.astype(np.float32)
        self._on_planes = surface.points.astype(np.float32)
        self.points = key_frame.points

    def put_into(self, volume: Volume) -> None:
        """Add the planes to a volume."""
        volume.add_planes(self._on_planes, self._normals, self.pose)

    def take_from(self, volume: Volume) -> None:
        """Take the planes out of a volume."""
        volume.remove_planes(self._on_planes, self._normals, self.pose)


def apart(first: Pose, second: Pose) -> float:
    """Return by how much what a sensor sees moves between two poses, metres."""
    way = inverse(first) @ second
    return distance(way) + ARM * angle(way)
