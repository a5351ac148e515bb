"""Saved sessions: everything that a shared map needs to continue, in one file."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path

import msgspec

from rce.errors import InvalidRequest, NotFound
from rce.mapping3d.back_ends import back_end
from rce.mapping3d.graph.state import SavedMapper
from rce.mapping3d.offload.shared_map import SharedMap
from rce.mapping3d.sensors import CAMERA

VERSION = 1
STATE, IMAGES = "state.msgpack", "images"


class SavedSession(msgspec.Struct, frozen=True):
    """Content of the file beside the images.

    Attributes:
        version: Of this format.
        runs: Names of robots and of their runs.
        mapper: The back end.
        sensor: What the robots measure with.
    """

    version: int
    runs: list[tuple[str, str]]
    mapper: SavedMapper
    sensor: str = CAMERA


def save_session(shared: SharedMap, path: Path) -> None:
    """Write a map to a file (ZIP, not compressed: the images are). A file that was there is replaced at the end.

    Raises:
        OSError: The file cannot be written.
    """
    part = path.with_name(f"{path.name}.part")
    with zipfile.ZipFile(part, "w", zipfile.ZIP_STORED) as archive:
        state = SavedSession(VERSION, shared.runs, shared.mapper.saved(), shared.sensor)
        archive.writestr(STATE, msgspec.msgpack.encode(state))
        with archive.open(IMAGES, "w", force_zip64=True) as images:
            shared.mapper.store.copy_to(images)
    part.replace(path)


def resume_session(path: Path, robots: Sequence[str], sensor: str = CAMERA) -> SharedMap:
    """Return the map of a file, which continues exactly as the saved one would have.

    A robot whose front end began anew since then is found on the map as a lost one is.

    Args:
        path: File that `save_session` wrote.
        robots: Names of the robots that will use the map.
        sensor: What they measure with.

    Raises:
        NotFound: The file does not exist.
        InvalidRequest: It is damaged, or of another version or sensor.
    """
    if not path.is_file():
        raise NotFound(f"no such session: {path}", field="path")
    try:
        with zipfile.ZipFile(path) as archive, archive.open(IMAGES) as images:
            saved = msgspec.msgpack.decode(archive.read(STATE), type=SavedSession)
            if saved.version != VERSION:
                raise InvalidRequest(f"{path.name} is a session of version {saved.version}; expected: {VERSION}")
            if any(not 0 <= each.robot < len(saved.runs) for each in saved.mapper.key_frames):
                raise InvalidRequest(f"{path.name} is damaged: a key frame has no robot")
            if saved.sensor != sensor:
                raise InvalidRequest(f"{path.name} is a session of robots with a {saved.sensor}; expected: {sensor}")
            mapper = back_end(sensor).resume(saved.mapper, images)
    except (zipfile.BadZipFile, KeyError, EOFError, msgspec.MsgspecError) as error:
        raise InvalidRequest(f"{path.name} is not a session of a mapper, or is damaged: {error}") from None
    return SharedMap.resumed(robots, saved.runs, sensor, mapper)
