"""Recordings in the format of the TUM RGB-D benchmark: a directory with rgb.txt and depth.txt."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from rce.errors import InvalidRequest
from rce.mapping3d.camera import Camera
from rce.mapping3d.files.recordings.images import Undistortion, checked, read_color, read_depth
from rce.mapping3d.files.trajectories import nearest_stamps
from rce.mapping3d.frames import RgbdFrame

SCALE = 5000.0  # units a metre
DEFAULT = (525.0, 525.0, 319.5, 239.5)  # which the benchmark recommends for images of 640 x 480
# Calibrations that the benchmark publishes for its cameras: fx, fy, cx, cy, and k1, k2, p1, p2, k3.
CALIBRATIONS = {
    "freiburg1": ((517.3, 516.5, 318.6, 255.3), (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "freiburg2": ((520.9, 521.0, 325.1, 249.7), (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "freiburg3": ((535.4, 539.2, 320.1, 247.6), ()),
}


class TumRecording:
    """A directory with lists of colour and depth images; ones within 0.02 s belong together.

    Attributes:
        name: Name of the directory.
        camera: The camera.
        frames: Number of frames.
    """

    def __init__(self, path: Path, camera: tuple[float, float, float, float] | None, scale: float | None) -> None:
        """Open a recording.

        Args:
            path: The directory.
            camera: fx, fy, cx, cy in pixels; None for the published ones of the camera that is named in the path, else
                those that the benchmark recommends.
            scale: Units of the depths in a metre; None for 5000.

        Raises:
            InvalidRequest: A file is missing or damaged.
        """
        self.name = path.name
        self._path = path
        self._scale = scale or SCALE
        colors, depths = read_list(path / "rgb.txt"), read_list(path / "depth.txt")
        pairs = nearest_stamps([stamp for stamp, _ in colors], [stamp for stamp, _ in depths])
        self._pairs = [(colors[i][0], path / colors[i][1], path / depths[k][1]) for i, k in pairs]
        if not self._pairs:
            raise InvalidRequest(f"{self.name}: no stamp in rgb.txt is within 0.02 s of one in depth.txt", field="path")
        self.frames = len(self._pairs)
        height, width = read_color(self._pairs[0][1]).shape[:2]
        known = next((value for key, value in CALIBRATIONS.items() if key in path.absolute().as_posix()), None)
        intrinsics, distortion = (camera, ()) if camera else known or (DEFAULT, ())
        factor = 1.0 if camera else width / 640
        self.camera = Camera(width, height, *(value * factor for value in intrinsics))
        self._undistort = Undistortion(self.camera, distortion) if distortion else None

    def __iter__(self) -> Iterator[RgbdFrame]:
        """Yield the frames in order of time.

        Raises:
            InvalidRequest: A file is missing or damaged.
        """
        for stamp, color, depth in self._pairs:
            frame = RgbdFrame(stamp, read_color(color), read_depth(depth, self._scale))
            checked(frame, self.camera, color.name)
            yield self._undistort(frame) if self._undistort else frame


def read_list(path: Path) -> list[tuple[float, str]]:
    """Return stamps and file names of lines `timestamp name`, in order of time.

    Raises:
        InvalidRequest: The file is missing, or a line has other contents.
    """
    if not path.is_file():
        raise InvalidRequest(f"{path.parent.name} has no {path.name}", field="path")
    entries = []
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        try:
            stamp, name = float(words[0]), words[1]
            if not math.isfinite(stamp):
                raise ValueError("the stamp is not a number")
        except (ValueError, IndexError) as error:
            raise InvalidRequest(
                f"{path.name}, line {number}: expected a time stamp and a file name ({error})", field="path"
            ) from None
        if not (path.parent / name).resolve().is_relative_to(path.parent.resolve()):
            raise InvalidRequest(f"{path.name}, line {number}: the file is outside of the recording", field="path")
        entries.append((stamp, name))
    return sorted(entries)
