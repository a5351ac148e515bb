"""Recordings of cameras with depth and of lidars as streams of frames, independent of the file format."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from rce.errors import InvalidRequest, NotFound
from rce.mapping.clouds import CLOUD_TYPE, Sweep
from rce.mapping.files.recordings.bags import opened_bag
from rce.mapping3d.camera import Camera
from rce.mapping3d.files.recordings.bags import BAG_SUFFIXES, COMPRESSED, IMAGE, RgbdBag
from rce.mapping3d.files.recordings.lidars import LidarBag
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


class LidarRecording(Protocol):
    """Recording that can be iterated repeatedly and yields its sweeps in order of time.

    The iteration raises InvalidRequest if a file turns out to be damaged.

    Attributes:
        name: Name of the file or directory.
        frames: Number of sweeps.
    """

    @property
    def name(self) -> str:
        """Name of the file or directory."""

    @property
    def frames(self) -> int:
        """Number of sweeps."""

    def __iter__(self) -> Iterator[Sweep]:
        """Yield the sweeps in order of time."""


Recording3d = RgbdRecording | LidarRecording


def camera_of(recording: Recording3d) -> Camera | None:
    """Return the camera of a recording, None for one of a lidar."""
    return getattr(recording, "camera", None)


def open_recording(
    path: Path, camera: Intrinsics | None = None, scale: float | None = None, topic: str = ""
) -> Recording3d:
    """Open a directory in the format of TUM or 7-Scenes, a ROS 1 bag, or a ROS 2 bag.

    A bag with colour and depth is one of a camera, unless `topic` names clouds; otherwise it is one of a lidar.

    Args:
        path: The file or directory.
        camera: fx, fy, cx, cy in pixels, None for those of the recording.
        scale: Units of depth images in a metre, None for those of the format.
        topic: Topic of the clouds in a bag; empty if there is only one.

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
            return _open_bag(path, camera, scale, topic)
        if any(NAME.fullmatch(each.name) for each in path.iterdir()):
            return SevenScenes(path, camera, scale)
    elif path.suffix in BAG_SUFFIXES:
        return _open_bag(path, camera, scale, topic)
    raise InvalidRequest(
        f"{path.name} is not a recording of a camera with depth or of a lidar: expected a directory with rgb.txt and "
        f"depth.txt (TUM) or frame-NNNNNN.color.jpg (7-Scenes), or a bag ({', '.join(BAG_SUFFIXES)})",
        field="path",
    )


def _open_bag(path: Path, camera: Intrinsics | None, scale: float | None, topic: str) -> Recording3d:
    with opened_bag(path) as reader:
        kinds = {each.topic: each.msgtype for each in reader.connections if each.msgcount}
    images = any(kind in (IMAGE, COMPRESSED) and "depth" in name.lower() for name, kind in kinds.items())
    if topic or (CLOUD_TYPE in kinds.values() and not images):
        return LidarBag(path, topic)
    return RgbdBag(path, camera, scale)
