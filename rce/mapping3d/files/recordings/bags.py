"""ROS 1 and ROS 2 bags with colour, depth and camera_info."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader

from rce.errors import InvalidRequest
from rce.mapping.files.recordings.bags import opened_bag
from rce.mapping3d.camera import Camera, Depth
from rce.mapping3d.files.recordings.images import Undistortion, checked, metres
from rce.mapping3d.frames import Image, RgbdFrame

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

BAG_SUFFIXES = (".bag", ".db3", ".mcap")
IMAGE, COMPRESSED, INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo"
MILLIMETRES = 1000.0  # units a metre of 16UC1 (REP 118)
MAX_APART = 0.02  # seconds between colour and depth of one frame
MAX_WAITING = 30  # images of one kind that wait for the other
HEADER = 12  # bytes before the image in a message of compressed depth
COLORS = {  # encoding: channels, conversion to RGB
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    "8UC1": (1, cv2.COLOR_GRAY2RGB),
    "8UC3": (3, cv2.COLOR_BGR2RGB),
}


class RgbdBag:
    """Frames of a bag whose depth images are registered to the colour images.

    Topics are found by their names: of several, depths registered to colour come first, then the most messages.

    Attributes:
        name: Name of the bag.
        camera: The camera.
        frames: Number of depth images.
    """

    def __init__(self, path: Path, camera: tuple[float, float, float, float] | None, scale: float | None) -> None:
        """Open a bag and choose its topics.

        Args:
            path: The file or directory.
            camera: fx, fy, cx, cy in pixels, None for those of camera_info.
            scale: Units of integer depths in a metre, None for 1000.

        Raises:
            InvalidRequest: The bag cannot be read, or lacks colour, depth or camera_info.
        """
        self.name = path.name
        self._path = path
        self._scale = scale or MILLIMETRES
        with opened_bag(self._path) as reader:
            images = [each for each in reader.connections if each.msgtype in (IMAGE, COMPRESSED) and each.msgcount]
            self._depth = self._choose([each for each in images if _is_depth(each.topic)], "depth")
            self._color = self._choose([each for each in images if not _is_depth(each.topic)], "color")
            self.frames = sum(each.msgcount for each in reader.connections if each.topic == self._depth)
            width, height, intrinsics, distortion = self._intrinsics(reader, camera)
        self.camera = Camera(width, height, *intrinsics)
        self._undistort = Undistortion(self.camera, distortion) if any(distortion) else None

    def __iter__(self) -> Iterator[RgbdFrame]:
        """Yield the frames in order of time.

        Raises:
            InvalidRequest: The bag is damaged, or has images of an unknown encoding.
        """
        colors: deque[tuple[float, Image]] = deque(maxlen=MAX_WAITING)
        depths: deque[tuple[float, Depth]] = deque(maxlen=MAX_WAITING)
        with opened_bag(self._path) as reader:
            chosen = [each for each in reader.connections if each.topic in (self._color, self._depth)]
            for connection, received, data in reader.messages(chosen):
                message: Any = reader.deserialize(data, connection.msgtype)
                stamp = (message.header.stamp.sec + message.header.stamp.nanosec * 1e-9) or received * 1e-9
                if connection.topic == self._color:
                    colors.append((stamp, color_image(message)))
                else:
                    depths.append((stamp, depth_image(message, self._scale)))
                for frame in paired(colors, depths):
                    checked(frame, self.camera, self.name)
                    yield self._undistort(frame) if self._undistort else frame

    def _choose(self, connections: list[Connection], what: str) -> str:
        if not connections:
            raise InvalidRequest(f"{self.name} has no topic with {what} images", field="path")
        return max(connections, key=lambda each: (*_preference(each.topic), each.msgcount)).topic

    def _intrinsics(
        self, reader: AnyReader, given: tuple[float, float, float, float] | None
    ) -> tuple[int, int, tuple[float, float, float, float], list[float]]:
        """Return width, height, fx, fy, cx, cy and the distortion of the camera."""
        infos = [each for each in reader.connections if each.msgtype == INFO and each.msgcount]
        if not infos:
            if given is None:
                raise InvalidRequest(f"{self.name} has no camera_info: give --camera FX,FY,CX,CY", field="camera")
            depth = next(each for each in reader.connections if each.topic == self._depth)
            _, _, data = next(reader.messages([depth]))
            shape = depth_image(reader.deserialize(data, depth.msgtype), self._scale).shape
            return shape[1], shape[0], given, []
        # Registered depths have the camera of the colours.
        wanted = _namespace(self._color)
        info = max(infos, key=lambda each: (_namespace(each.topic) == wanted, _common(each.topic, self._color)))
        _, _, data = next(reader.messages([info]))
        message: Any = reader.deserialize(data, info.msgtype)
        matrix = np.asarray(getattr(message, "k", getattr(message, "K", None)), np.float64).reshape(3, 3)
        coefficients = np.asarray(getattr(message, "d", getattr(message, "D", ())), np.float64).tolist()
        rectified = "rect" in self._color
        if given:
            return message.width, message.height, given, []
        found = (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])
        if not (found[0] > 0 and found[1] > 0):
            raise InvalidRequest(
                f"{self.name}: {info.topic} is not calibrated: give --camera FX,FY,CX,CY", field="camera"
            )
        return message.width, message.height, found, [] if rectified else coefficients[:8]


def color_image(message: Any) -> Image:
    """Return the colours of a message of type Image or CompressedImage.

    Raises:
        InvalidRequest: The encoding is unknown.
    """
    if hasattr(message, "format"):
        image = cv2.imdecode(np.asarray(message.data, np.uint8), cv2.IMREAD_COLOR)
        if image is None:
            raise InvalidRequest(f"a compressed image of format {message.format!r} cannot be read", field="path")
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)
    if message.encoding not in COLORS:
        known = ", ".join(COLORS)
        raise InvalidRequest(f"the encoding {message.encoding} of colours is unknown; known: {known}", field="path")
    channels, conversion = COLORS[message.encoding]
    pixels = _rows(message, np.dtype(np.uint8), channels)
    return np.ascontiguousarray(pixels if conversion is None else cv2.cvtColor(pixels, conversion), np.uint8)


def depth_image(message: Any, scale: float) -> Depth:
    """Return the depths of a message of type Image or CompressedImage, metres, 0 = none (REP 118).

    Raises:
        InvalidRequest: The encoding is unknown.
    """
    if hasattr(message, "format"):
        data = np.asarray(message.data, np.uint8)
        start = HEADER if "compressedDepth" in message.format else 0
        image = cv2.imdecode(data[start:], cv2.IMREAD_UNCHANGED) if len(data) > start else None
        if image is None or image.dtype != np.uint16 or "rvl" in message.format.lower():
            raise InvalidRequest(
                f"compressed depth of format {message.format!r} cannot be read: expected PNG of 16 bits", field="path"
            )
        return metres(image.astype(np.uint16), scale)
    order = ">" if message.is_bigendian else "<"
    if message.encoding in ("16UC1", "mono16"):
        return metres(_rows(message, np.dtype(f"{order}u2"), 1).astype(np.uint16), scale)
    if message.encoding == "32FC1":
        depth = _rows(message, np.dtype(f"{order}f4"), 1).astype(np.float32)
        return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))
    raise InvalidRequest(
        f"the encoding {message.encoding} of depths is unknown; known: 16UC1, mono16, 32FC1", field="path"
    )


def _rows(message: Any, kind: np.dtype[Any], channels: int) -> NDArray[Any]:
    """Return the pixels (height, width) or (height, width, channels) of an image whose rows may be padded."""
    used = message.width * channels * kind.itemsize
    data = np.asarray(message.data, np.uint8)
    if message.step < used or data.size < message.step * message.height:
        raise InvalidRequest("an image has fewer bytes than its size says", field="path")
    rows = np.ascontiguousarray(data[: message.step * message.height].reshape(message.height, message.step)[:, :used])
    shape = (message.height, message.width) if channels == 1 else (message.height, message.width, channels)
    return rows.view(kind).reshape(shape)


def paired(colors: deque[tuple[float, Image]], depths: deque[tuple[float, Depth]]) -> Iterator[RgbdFrame]:
    """Remove pairs of colour and depth of one moment from what waits, each with its stamp, and yield them as frames."""
    while colors and depths:
        color, depth = colors[0], depths[0]
        if abs(color[0] - depth[0]) <= MAX_APART:
            colors.popleft()
            depths.popleft()
            yield RgbdFrame(color[0], color[1], depth[1])
        elif color[0] < depth[0]:
            colors.popleft()
        else:
            depths.popleft()


def _is_depth(topic: str) -> bool:
    return "depth" in topic.lower()


def _preference(topic: str) -> tuple[bool, bool]:
    """Return what makes a topic better than another of its kind."""
    lower = topic.lower()
    registered = "registered" in lower or "aligned" in lower
    return registered, not ("infra" in lower or "/ir" in lower or "mono" in lower)


def _namespace(topic: str) -> str:
    return topic.removesuffix("/compressed").rpartition("/")[0]


def _common(first: str, second: str) -> int:
    """Return the number of characters with which both begin."""
    return next(
        (i for i, (a, b) in enumerate(zip(first, second, strict=False)) if a != b), min(len(first), len(second))
    )
