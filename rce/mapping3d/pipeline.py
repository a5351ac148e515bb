"""Front ends, back end and dense map in one process: recordings in, the map and the trajectories out."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rce.mapping.files.outputs import write_atomically
from rce.mapping3d.back_ends import back_end, dense_map
from rce.mapping3d.dense.dense_map import DenseMap
from rce.mapping3d.files.recordings import Recording3d, camera_of
from rce.mapping3d.files.recordings.together import together
from rce.mapping3d.files.trajectories import Stamped, trajectory_text
from rce.mapping3d.graph.trajectory import Trajectory
from rce.mapping3d.offload.runs import nothing_to_begin_with, sensor_of
from rce.mapping3d.poses import inverse
from rce.mapping3d.sensors import front_end


@dataclass(slots=True)
class Figures:
    """Statistics of a run over recordings.

    Attributes:
        frames: Number of frames of all robots.
        lost: Those whose pose could not be measured.
        front: CPU seconds of the front ends.
        back: CPU seconds of the back end.
    """

    frames: int = 0
    lost: int = 0
    front: float = 0.0
    back: float = 0.0


class Mapping:
    """Mapping of recordings, each of a robot of its own, all at the same time.

    Attributes:
        mapper: The back end.
        figures: What it took so far.
    """

    def __init__(self, recordings: Sequence[Recording3d]) -> None:
        """Prepare.

        Args:
            recordings: One for each robot.
        """
        self._sensor = sensor_of(recordings)
        self.mapper = back_end(self._sensor)
        self.figures = Figures()
        self._recordings = recordings
        self._paths = [Trajectory() for _ in recordings]

    def run(self, progress: Callable[[int], None] = lambda frames: None) -> None:
        """Map all frames.

        Args:
            progress: Called after each frame with the number of frames so far.

        Raises:
            InvalidRequest: A recording is damaged, or has no frame with enough depth.
        """
        trackers = [front_end(camera_of(each), robot) for robot, each in enumerate(self._recordings)]
        for robot, frame in together(self._recordings):
            began = time.process_time()
            tracked = trackers[robot].add(frame)
            middle = time.process_time()
            self.mapper.add(tracked)
            self.figures.back += time.process_time() - middle
            self.figures.front += middle - began
            self.figures.frames += 1
            self.figures.lost += tracked.lost
            self._paths[robot].add(tracked)
            progress(self.figures.frames)
        began = time.process_time()
        self.mapper.finish()
        self.figures.back += time.process_time() - began
        for robot, recording in enumerate(self._recordings):
            if not self.trajectory(robot):
                raise nothing_to_begin_with(recording)

    def trajectory(self, robot: int) -> list[Stamped]:
        """Return the pose of every frame of a robot. The first frame of the first robot on a map is its origin."""
        poses = self._poses(robot)
        if not poses:
            return []
        first = self._poses(self.robots_with(robot)[0])
        origin = inverse(first[0][1])
        return [(stamp, origin @ pose) for stamp, pose in poses]

    def _poses(self, robot: int) -> list[Stamped]:
        return self._paths[robot].poses(partial(self.mapper.pose, robot))

    def robots_with(self, robot: int) -> list[int]:
        """Return the robots that are on the same map as a robot, itself included."""
        own = self.mapper.map_of(robot, 0)
        return [each for each, _ in enumerate(self._recordings) if self.mapper.map_of(each, 0) == own]

    def dense(self, robot: int) -> DenseMap:
        """Return the dense map on which a robot is, in the frame of `trajectory`."""
        first = self.robots_with(robot)[0]
        origin = inverse(self._poses(first)[0][1])
        dense = dense_map(self._sensor)
        for key, pose in self.mapper.key_frames(self.mapper.map_of(robot, 0)):
            dense.add(key, origin @ pose)
        return dense

    def write(self, directory: Path) -> list[tuple[Path, list[int]]]:
        """Write trajectories, clouds, meshes, floor plans and pictures.

        Returns:
            The directory of each map, and the robots on it: `directory` for the first map, `map_2` and so on in it for
            others.
        """
        written: list[tuple[Path, list[int]]] = []
        placed: set[int] = set()
        for robot, _ in enumerate(self._recordings):
            if robot in placed:
                continue
            team = self.robots_with(robot)
            placed.update(team)
            path = directory / f"map_{len(written) + 1}" if written else directory
            path.mkdir(parents=True, exist_ok=True)
            ways = {each: self.trajectory(each) for each in team}
            for each, way in ways.items():
                name = f"trajectory-{each + 1}.txt" if len(self._recordings) > 1 else "trajectory.txt"
                write_atomically(path / name, trajectory_text(way))
            self.dense(robot).write(path, {each: [pose for _, pose in way] for each, way in ways.items()})
            written.append((path, team))
        return written
