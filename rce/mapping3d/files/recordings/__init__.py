"""Recordings of cameras with depth as streams of frames, independent of the file format."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from rce.errors import InvalidRequest, NotFound
from rce.mapping3d.camera import Camera
from rce.mapping3d.files.recordings.bags import BAG_SUFFIXES, RgbdBag
from rce.mapping3d.files.recordings.seven_scenes import NAME, SevenScenes
from rce.mapping3d.files.recordings.tum import TumRecording
from rce.mapping3d.frames import RgbdFrame

Intrinsics = tuple[float, float, float, float]


class RgbdRecording(Protocol):
    """Recording that can be iterated repeatedly and yields its frames in order of time.

    The iteration raises InvalidRequest if a file turns out to be damaged.

    Attributes:
        name: Name of the file or directory.
        camera: The camera of all frames; they are without distortion.
        frames: Number of frames; an upper bound for bags.
    """

    name: str
    camera: Camera
    frames: int

    def __iter__(self) -> Iterator[RgbdFrame]:
        """Yield the frames in order of time."""


def open_recording(path: Path, camera: Intrinsics | None = None, scale: float | None = None) -> RgbdRecording:
    """Open a directory in the format of TUM or 7-Scenes, a ROS 1 bag, or a ROS 2 bag.

    Args:
        path: The file or directory.
        camera: fx, fy, cx, cy in pixels, None for those of the recording.
        scale: Units of depth images in a metre, None for those of the format.

    Raises:
        NotFound: The file does not exist.
        InvalidRequest: The recording has another format, is damaged, or has no frames.
    """
    if not path.exists():
        raise NotFound(f"no such recording: {path}", field="path")
    path = path.resolve() if path.name in ("", ".", "..") else path
    if path.is_dir():
        if (path / "rgb.txt").exists() or (path / "depth.txt").exists():
            return TumRecording(path, camera, scale)
        if (path / "metadata.yaml").exists():
            return RgbdBag(path, camera, scale)
        if any(NAME.fullmatch(each.name) for each in path.iterdir()):
            return SevenScenes(path, camera, scale)
    elif path.suffix in BAG_SUFFIXES:
        return RgbdBag(path, camera, scale)
    raise InvalidRequest(
        f"{path.name} is not a recording of a camera with depth: expected a directory with rgb.txt and depth.txt (TUM) "
        f"or frame-NNNNNN.color.jpg (7-Scenes), or a bag ({', '.join(BAG_SUFFIXES)})",
        field="path",
    )
