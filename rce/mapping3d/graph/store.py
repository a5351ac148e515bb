"""Images or points of key frames, compressed, in a file without a name: memory does not grow with the run."""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import dataclass
from typing import IO

import cv2
import numpy as np

from rce.errors import InvalidRequest
from rce.mapping3d.camera import Camera
from rce.mapping3d.frames import AnyKeyFrame, CloudKeyFrame, KeyFrame, RgbdFrame
from rce.mapping3d.lidar.packing import pack_points, unpack_points

UNITS = 4000.0  # of depth in a metre: quarters of a millimetre, up to 16 m
QUALITY = 92  # of JPEG


@dataclass(frozen=True, slots=True)
class Packed:
    """A key frame, compressed.

    Attributes:
        robot: Number of the robot.
        index: Number among the key frames of this robot.
        stamp: Seconds.
        camera: The camera, None for a lidar.
        color: JPEG.
        depth: PNG of 16 bits, quarters of a millimetre.
        cloud: Points of a lidar (`lidar.packing`).
    """

    robot: int
    index: int
    stamp: float
    camera: Camera | None
    color: bytes = b""
    depth: bytes = b""
    cloud: bytes = b""


def pack(key: AnyKeyFrame) -> Packed:
    """Return a key frame, compressed."""
    if isinstance(key, CloudKeyFrame):
        return Packed(key.robot, key.index, key.stamp, None, cloud=pack_points(key.points))
    bgr = cv2.cvtColor(key.frame.color, cv2.COLOR_RGB2BGR)
    units = np.clip(np.round(key.frame.depth * UNITS), 0, 65535).astype(np.uint16)
    color = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()
    depth = cv2.imencode(".png", units, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
    return Packed(key.robot, key.index, key.frame.stamp, key.camera, color, depth)


def unpack_cloud(packed: Packed) -> CloudKeyFrame:
    """Return a key frame of a lidar from its compressed form.

    Raises:
        InvalidRequest: It is damaged, or is one of a camera.
    """
    if packed.camera is not None:
        raise InvalidRequest(f"key frame {packed.index} of robot {packed.robot} is one of a camera, not of a lidar")
    return CloudKeyFrame(packed.robot, packed.index, packed.stamp, unpack_points(packed.cloud))


def unpack(packed: Packed) -> KeyFrame:
    """Return a key frame of a camera from its compressed form.

    Raises:
        InvalidRequest: It is damaged, or is one of a lidar.
    """
    if packed.camera is None:
        raise InvalidRequest(f"key frame {packed.index} of robot {packed.robot} is one of a lidar, not of a camera")
    # OpenCV raises an error of its own for an empty buffer.
    color = cv2.imdecode(np.frombuffer(packed.color, np.uint8), cv2.IMREAD_COLOR) if packed.color else None
    depth = cv2.imdecode(np.frombuffer(packed.depth, np.uint8), cv2.IMREAD_UNCHANGED) if packed.depth else None
    size = (packed.camera.height, packed.camera.width)
    if color is None or depth is None or color.shape[:2] != size or depth.shape != size or depth.dtype != np.uint16:
        raise InvalidRequest(f"key frame {packed.index} of robot {packed.robot} is damaged")
    rgb = np.asarray(cv2.cvtColor(color, cv2.COLOR_BGR2RGB), np.uint8)
    frame = RgbdFrame(packed.stamp, rgb, depth.astype(np.float32) / np.float32(UNITS))
    return KeyFrame(packed.robot, packed.index, frame, packed.camera)


class KeyFrameStore:
    """Compressed key frames in a temporary file, by number in the order in which they were added."""

    def __init__(self) -> None:
        """Create an empty store."""
        self._file = tempfile.TemporaryFile(prefix="rce-mapping3d-")  # noqa: SIM115 - closed with the store
        self._entries: list[_Entry] = []
        self._end = 0

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, packed: Packed) -> int:
        """Add a key frame and return its number."""
        self._file.seek(self._end)
        parts = (packed.color, packed.depth, packed.cloud)
        self._file.write(b"".join(parts))
        sizes = len(packed.color), len(packed.depth), len(packed.cloud)
        self._entries.append(_Entry(self._end, sizes, packed.robot, packed.index, packed.stamp, packed.camera))
        self._end += sum(sizes)
        return len(self._entries) - 1

    def name(self, number: int) -> tuple[int, int]:
        """Return the robot and the index of a key frame."""
        entry = self._entries[number]
        return entry.robot, entry.index

    def stamp(self, number: int) -> float:
        """Return the stamp of a key frame, seconds."""
        return self._entries[number].stamp

    def camera(self, number: int) -> Camera | None:
        """Return the camera of a key frame, None for one of a lidar."""
        return self._entries[number].camera

    def packed(self, number: int) -> Packed:
        """Return a key frame, compressed."""
        entry = self._entries[number]
        self._file.seek(entry.begin)
        color, depth, cloud = (self._file.read(size) for size in entry.sizes)
        return Packed(entry.robot, entry.index, entry.stamp, entry.camera, color, depth, cloud)

    def key_frame(self, number: int) -> KeyFrame:
        """Return a key frame of a camera."""
        return unpack(self.packed(number))

    def copy_to(self, target: IO[bytes]) -> None:
        """Write the content of all key frames one after the other: colour, then depth, then points, of each."""
        self._file.seek(0)
        shutil.copyfileobj(self._file, target)

    def sizes(self) -> list[tuple[int, int, int]]:
        """Return the bytes of colour, depth and points of each key frame."""
        return [entry.sizes for entry in self._entries]

    def close(self) -> None:
        """Remove the file."""
        self._file.close()


@dataclass(frozen=True, slots=True)
class _Entry:
    """Place of a key frame: its first byte, the sizes of its parts, and its names."""

    begin: int
    sizes: tuple[int, int, int]
    robot: int
    index: int
    stamp: float
    camera: Camera | None
