"""Recordings in the format of 7-Scenes: frame-NNNNNN.color.jpg or .png, frame-NNNNNN.depth.png, intrinsics."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from rce.errors import InvalidRequest
from rce.mapping3d.camera import Camera
from rce.mapping3d.files.recordings.images import ColorCamera, checked, edge_agreement, read_color, read_depth
from rce.mapping3d.frames import RgbdFrame

RATE = 30.0  # frames a second
SCALE = 1000.0  # units a metre
NAME = re.compile(r"frame-(\d+)\.color\.(?:jpg|jpeg|png)")
# The colour camera of a Kinect beside its infrared camera: focal length of both at a width of 640, and the distance.
KINECT_FOCAL, KINECT_DEPTH_FOCAL, KINECT_OFFSET = 527.0, 585.0, 0.024
SAMPLES = 8  # frames from which is told whether colours are registered to depths
MARGIN = 1.05  # by which the edges must agree better for colours to be those of a camera of their own


class SevenScenes:
    """A directory of numbered frames; the stamp of a frame is its number / 30 s.

    The pictures of the original recordings are those of the two cameras of a Kinect as they are. Whether that is so is
    found from the agreement of edges in colours and depths; colours are then registered to the depths.

    Attributes:
        name: Name of the directory.
        camera: The camera of the depths.
        frames: Number of frames.
        color: The camera of the colours, None if they are registered.
    """

    def __init__(self, path: Path, camera: tuple[float, float, float, float] | None, scale: float | None) -> None:
        """Open a recording.

        Args:
            path: The directory.
            camera: fx, fy, cx, cy in pixels; None to read them from the file with `intrinsics` in its name.
            scale: Units of the depths in a metre; None for 1000.

        Raises:
            InvalidRequest: A file is missing or damaged.
        """
        self.name = path.name
        self._path = path
        self._scale = scale or SCALE
        found = {int(match[1]): each for each in path.iterdir() if (match := NAME.fullmatch(each.name))}
        self._colors = [
            (number, color) for number, color in sorted(found.items()) if (path / depth_name(color)).exists()
        ]
        if not self._colors:
            raise InvalidRequest(f"{self.name} has no frame with both color and depth", field="path")
        self.frames = len(self._colors)
        size = read_depth(path / depth_name(self._colors[0][1]), self._scale).shape
        self.camera = Camera(size[1], size[0], *(camera or read_intrinsics(path)))
        self.color: ColorCamera | None = None
        self.color = self._color_camera()

    def __iter__(self) -> Iterator[RgbdFrame]:
        """Yield the frames.

        Raises:
            InvalidRequest: A file is damaged.
        """
        for number, color in self._colors:
            yield self._frame(number, color)

    def _frame(self, number: int, color: Path) -> RgbdFrame:
        depth = read_depth(self._path / depth_name(color), self._scale)
        frame = RgbdFrame(number / RATE, read_color(color), depth)
        checked(frame, self.camera, color.name)
        return self.color.registered(frame, self.camera) if self.color else frame

    def _color_camera(self) -> ColorCamera | None:
        camera = self.camera
        kinect = KINECT_DEPTH_FOCAL * camera.width / 640
        if abs(camera.fx - kinect) > 0.02 * kinect:  # the depths of other cameras come registered
            return None
        focal = KINECT_FOCAL * camera.width / 640
        beside = ColorCamera(Camera(camera.width, camera.height, focal, focal, 320.0, 238.0), KINECT_OFFSET)
        numbers = np.linspace(0, self.frames - 1, min(SAMPLES, self.frames)).astype(int)
        frames = [self._frame(*self._colors[number]) for number in numbers]
        plain = sum(edge_agreement(frame) for frame in frames)
        registered = sum(edge_agreement(beside.registered(frame, camera)) for frame in frames)
        return beside if registered > MARGIN * plain else None


def depth_name(color: Path) -> str:
    """Return the name of the depth image that belongs to a colour image."""
    return color.name.partition(".")[0] + ".depth.png"


def read_intrinsics(path: Path) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy of the file with `intrinsics` in its name, a matrix of three rows.

    Raises:
        InvalidRequest: There is no such file, or it has other contents.
    """
    files = sorted(each for each in path.iterdir() if "intrinsics" in each.name.lower() and each.is_file())
    if not files:
        raise InvalidRequest(
            f"{path.name} has no file with the intrinsics of the camera: give --camera FX,FY,CX,CY", field="camera"
        )
    try:
        matrix = np.loadtxt(files[0], ndmin=2)
        fx, fy, cx, cy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    except (ValueError, IndexError, UnicodeDecodeError) as error:
        raise InvalidRequest(
            f"{files[0].name} is not a matrix of three rows with the intrinsics: {error}", field="camera"
        ) from None
    return fx, fy, cx, cy
