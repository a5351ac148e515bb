"""Images of key frames, compressed, in a file without a name: memory does not grow with the length of a run."""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import dataclass
from typing import IO

import cv2
import numpy as np

from rce.errors import InvalidRequest
from rce.mapping3d.camera import Camera
from rce.mapping3d.frames import KeyFrame, RgbdFrame

UNITS = 4000.0  # of depth in a metre: quarters of a millimetre, up to 16 m
QUALITY = 92  # of JPEG


@dataclass(frozen=True, slots=True)
class Packed:
    """A key frame, compressed.

    Attributes:
        robot: Number of the robot.
        index: Number among the key frames of this robot.
        stamp: Seconds.
        camera: The camera.
        color: JPEG.
        depth: PNG of 16 bits, quarters of a millimetre.
    """

    robot: int
    index: int
    stamp: float
    camera: Camera
    color: bytes
    depth: bytes


def pack(key: KeyFrame) -> Packed:
    """Return a key frame, compressed."""
    bgr = cv2.cvtColor(key.frame.color, cv2.COLOR_RGB2BGR)
    units = np.clip(np.round(key.frame.depth * UNITS), 0, 65535).astype(np.uint16)
    color = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()
    depth = cv2.imencode(".png", units, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
    return Packed(key.robot, key.index, key.frame.stamp, key.camera, color, depth)


def unpack(packed: Packed) -> KeyFrame:
    """Return a key frame from its compressed form.

    Raises:
        InvalidRequest: It is damaged.
    """
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
        self._entries: list[tuple[int, int, int, int, int, float, Camera]] = []
        self._end = 0

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, packed: Packed) -> int:
        """Add a key frame and return its number."""
        self._file.seek(self._end)
        self._file.write(packed.color + packed.depth)
        sizes = (self._end, len(packed.color), len(packed.depth))
        self._entries.append((*sizes, packed.robot, packed.index, packed.stamp, packed.camera))
        self._end += sizes[1] + sizes[2]
        return len(self._entries) - 1

    def name(self, number: int) -> tuple[int, int]:
        """Return the robot and the index of a key frame."""
        _, _, _, robot, index, _, _ = self._entries[number]
        return robot, index

    def stamp(self, number: int) -> float:
        """Return the stamp of a key frame, seconds."""
        return self._entries[number][5]

    def camera(self, number: int) -> Camera:
        """Return the camera of a key frame."""
        return self._entries[number][6]

    def packed(self, number: int) -> Packed:
        """Return a key frame, compressed."""
        begin, color, depth, robot, index, stamp, camera = self._entries[number]
        self._file.seek(begin)
        content = self._file.read(color + depth)
        return Packed(robot, index, stamp, camera, content[:color], content[color:])

    def key_frame(self, number: int) -> KeyFrame:
        """Return a key frame."""
        return unpack(self.packed(number))

    def copy_to(self, target: IO[bytes]) -> None:
        """Write the compressed images of all key frames one after the other: colour, then depth, of each."""
        self._file.seek(0)
        shutil.copyfileobj(self._file, target)

    def sizes(self) -> list[tuple[int, int]]:
        """Return the bytes of colour and depth of each key frame."""
        return [(color, depth) for _, color, depth, *_ in self._entries]

    def close(self) -> None:
        """Remove the file."""
        self._file.close()
