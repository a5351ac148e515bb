"""Recordings, each of a robot of its own, mapped through a platform: tracked here, mapped in an environment."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

from rce.client import Environment, Robot
from rce.errors import InvalidRequest
from rce.mapping.files.outputs import write_atomically
from rce.mapping3d.files.recordings import Recording3d, camera_of
from rce.mapping3d.files.recordings.together import together
from rce.mapping3d.files.trajectories import trajectory_text
from rce.mapping3d.graph.trajectory import Trajectory
from rce.mapping3d.offload.client import RgbdRobot, start_mapper
from rce.mapping3d.sensors import CAMERA, LIDAR

IMAGE = "rce/mapping3d"
MEMORY = 3 << 30  # bytes for the environment: the libraries, and the volume of a building
WINDOW = 8  # key frames of a robot that may be unanswered before its recording waits
FASTER = 1e12  # bytes per second: a recording is not slowed down


class Access(Protocol):
    """Entry of a platform, and who uses it."""

    @property
    def url(self) -> str:
        """URL of the Master's entry."""

    @property
    def user(self) -> str:
        """Name of the user."""

    @property
    def password(self) -> str | None:
        """Password, or None."""

    @property
    def key(self) -> str | None:
        """API key, or None."""


class WrittenMap(NamedTuple):
    """A map that was written.

    Attributes:
        directory: Where it is.
        robots: Numbers of the robots that are on it, from 0.
    """

    directory: Path
    robots: list[int]


@dataclass(slots=True)
class RunFigures:
    """Statistics of a run over recordings.

    Attributes:
        frames: Number of frames of all robots.
        lost: Those whose pose could not be measured.
        key_frames: Number of key frames.
        seconds: CPU time of this process, in which robots track.
        sent: Bytes of key frames.
    """

    frames: int = 0
    lost: int = 0
    key_frames: int = 0
    seconds: float = 0.0
    sent: int = 0


@asynccontextmanager
async def environment_for_mapping(robot: Robot, tag: str) -> AsyncIterator[Environment]:
    """Create an environment that can map in three dimensions, and destroy it at the end.

    An engine without images gets none.
    """
    environment = robot.environment(tag, restart="no", image=IMAGE, memory=MEMORY)
    try:
        await environment.__aenter__()
    except InvalidRequest:
        environment = robot.environment(tag, restart="no")
        await environment.__aenter__()
    try:
        yield environment
    finally:
        await environment.destroy()


async def map_recordings(
    access: Access,
    recordings: Sequence[Recording3d],
    directory: Path,
    progress: Callable[[int], None] = lambda frames: None,
) -> tuple[list[WrittenMap], RunFigures]:
    """Map recordings at the same time, and write trajectories and maps.

    Args:
        access: Entry of a platform.
        recordings: One for each robot.
        directory: For the first map; others are in `map_2` and so on in it.
        progress: Called after each frame with the number of frames so far.

    Raises:
        InvalidRequest: A recording is damaged, or has no frame with enough depth.
        Died: The mapper or its environment ended.
        TimedOut: The mapper does not answer.
    """
    name = f"map3d_{secrets.token_hex(4)}"
    async with AsyncExitStack() as stack:
        robots = [
            await stack.enter_async_context(
                Robot(access.url, user=access.user, robot=f"{name}_{tag}", password=access.password, key=access.key)
            )
            for tag in _tags(recordings)
        ]
        return await map_with(robots, f"env_{name}", recordings, directory, progress)


async def map_with(
    robots: Sequence[Robot],
    name: str,
    recordings: Sequence[Recording3d],
    directory: Path,
    progress: Callable[[int], None],
) -> tuple[list[WrittenMap], RunFigures]:
    """Do as `map_recordings` with connected robots, one for each recording, in a new environment of this name.

    Raises:
        RceError: The same errors as `map_recordings`, for the same reasons.
    """
    tags, sensor = _tags(recordings), sensor_of(recordings)
    async with AsyncExitStack() as stack:
        environment = await stack.enter_async_context(environment_for_mapping(robots[0], name))
        await start_mapper(environment, tags, sensor)
        members = [
            await stack.enter_async_context(
                RgbdRobot(
                    robot,
                    robot.environment(environment.tag),
                    camera_of(recording),
                    f"/{tag}",
                    rate=FASTER,
                )
            )
            for robot, recording, tag in zip(robots, recordings, tags, strict=True)
        ]
        paths, figures = await _drive(recordings, members, progress)
        return await _written(recordings, members, paths, directory), figures


def sensor_of(recordings: Sequence[Recording3d]) -> str:
    """Return what all recordings were made with, see `rce.mapping3d.sensors`.

    Raises:
        InvalidRequest: Some were made with a camera, others with a lidar.
    """
    found = {LIDAR if camera_of(each) is None else CAMERA for each in recordings}
    if len(found) > 1:
        raise InvalidRequest("recordings of cameras and of lidars cannot share a map: map them apart", field="path")
    return found.pop()


def nothing_to_begin_with(recording: Recording3d) -> InvalidRequest:
    """Return the error of a recording in which no frame could become a key frame."""
    what = "sweep with enough points" if camera_of(recording) is None else "frame with enough depth"
    return InvalidRequest(f"{recording.name} has no {what} to begin with", field="path")


def _tags(recordings: Sequence[Recording3d]) -> list[str]:
    return [f"robot_{number}" for number, _ in enumerate(recordings, 1)]


async def _drive(
    recordings: Sequence[Recording3d], members: Sequence[RgbdRobot], progress: Callable[[int], None]
) -> tuple[list[Trajectory], RunFigures]:
    """Track all frames, as if all recordings had begun at the same time, and have the map finished."""
    paths, figures = [Trajectory() for _ in recordings], RunFigures()
    frames = together(recordings)
    began = time.process_time()
    while (found := await asyncio.to_thread(next, frames, None)) is not None:
        robot, frame = found
        located = await members[robot].add(frame)
        paths[robot].add(located.tracked)
        await members[robot].settle(WINDOW)
        figures.frames += 1
        figures.lost += located.tracked.lost
        progress(figures.frames)
    figures.seconds = time.process_time() - began
    for member, recording in zip(members, recordings, strict=True):
        if not member.tracking.key_frames:
            raise nothing_to_begin_with(recording)
        await member.settle()
        figures.key_frames += member.tracking.key_frames
        figures.sent += member.sending.sent
    await members[0].finish()
    for member in members[1:]:
        await member.refresh()
    return paths, figures


async def _written(
    recordings: Sequence[Recording3d],
    members: Sequence[RgbdRobot],
    paths: Sequence[Trajectory],
    directory: Path,
) -> list[WrittenMap]:
    maps: dict[str, WrittenMap] = {}
    for number, (member, path) in enumerate(zip(members, paths, strict=True)):
        frame = member.tracking.map
        if frame not in maps:
            place = directory / f"map_{len(maps) + 1}" if maps else directory
            place.mkdir(parents=True, exist_ok=True)
            maps[frame] = WrittenMap(place, [])
            for name, content in (await member.files()).items():
                write_atomically(place / name, content)
        maps[frame].robots.append(number)
        name = f"trajectory-{number + 1}.txt" if len(recordings) > 1 else "trajectory.txt"
        write_atomically(maps[frame].directory / name, trajectory_text(path.poses(member.tracking.key_pose)))
    return list(maps.values())
