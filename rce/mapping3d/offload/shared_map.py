"""The cloud's side: maps of several robots in common frames, what each robot must be told, and dense maps."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rce.mapping.grid import OccupancyGrid
from rce.mapping3d.back_ends import back_end, dense_map
from rce.mapping3d.dense.dense_map import DenseMap
from rce.mapping3d.dense.mesh import Cloud, Mesh
from rce.mapping3d.graph.key_frame_mapper import KeyFrameMapper
from rce.mapping3d.graph.store import Packed
from rce.mapping3d.odometry.tracker import Tracked
from rce.mapping3d.offload.messages import KeyFrameMessage, unpacked
from rce.mapping3d.poses import Pose, inverse
from rce.mapping3d.sensors import CAMERA

Floats = NDArray[np.float64]

MAIN = "map"  # frame of the map on which the first robot began
AT_ONCE = 4  # key frames that the dense maps catch up with each new one
TOLD_SHIFT, TOLD_TURN = 0.001, 0.0005  # metres and (nearly) radians from which on a robot is told of a correction


@dataclass(frozen=True, slots=True)
class Corrected:
    """A key frame where the map has it now.

    Attributes:
        index: Index of the key frame in its run.
        stamp: Seconds.
        pose: (4, 4) sensor to the frame of the map.
        map: Frame of the map.
    """

    index: int
    stamp: float
    pose: Pose
    map: str


class SharedMap:
    """Maps of the key frames of robots, which become one where robots see the same place.

    The first key frame of a map's first robot is the origin of its frame: the first one that was named in `robots`.

    Attributes:
        robots: Names of the robots.
        sensor: What all of them measure with, see `rce.mapping3d.sensors`.
        mapper: The back end.
    """

    def __init__(self, robots: Sequence[str], sensor: str = CAMERA) -> None:
        """Begin with an empty map."""
        self.robots = list(robots)
        self.sensor = sensor
        self.mapper = back_end(sensor)
        self._runs: list[tuple[str, str]] = []  # name of a robot and of its run, by the number that the back end uses
        self._nodes: dict[str, list[int]] = {name: [] for name in robots}  # of the newest run
        self._told: dict[str, Floats] = {name: np.empty((0, 4, 4)) for name in robots}
        self._told_maps: dict[str, list[str]] = {name: [] for name in robots}
        self._dense: dict[int, DenseMap] = {}  # by the node at the origin
        self._in_dense: dict[int, set[int]] = {}  # nodes that were put in

    # --- key frames

    def add(self, robot: str, message: KeyFrameMessage) -> bool:
        """Add a key frame that a robot has sent. One that is on the map already changes nothing.

        Returns:
            False if it was not added, because the key frame to which it refers has not come yet.

        Raises:
            InvalidRequest: It is damaged, or of another sensor.
        """
        number = self._number(robot, message.run)
        if self.mapper.has(number, message.index):
            return True
        if message.linked and not self.mapper.has(number, message.reference):
            return False
        self._add(robot, *unpacked(message, number))
        return True

    def add_tracked(self, robot: str, run: str, tracked: Tracked) -> None:
        """Add the key frame, if there is one, of a front end that runs beside the map."""
        if tracked.key is not None:
            number = self._number(robot, run)
            key = dataclasses.replace(tracked.key, robot=number)
            self._add(robot, dataclasses.replace(tracked, key=key), None)

    def _add(self, robot: str, tracked: Tracked, packed: Packed | None) -> None:
        node = len(self.mapper.store)
        self.mapper.add(tracked, packed)
        self._nodes[robot].append(node)
        self.update_dense(AT_ONCE)

    def _number(self, robot: str, run: str) -> int:
        """Return the number of a run for the back end; a new run of a robot is told about its own key frames only."""
        if (robot, run) not in self._runs:
            self._runs.append((robot, run))
            self._nodes[robot] = []
            self._told[robot], self._told_maps[robot] = np.empty((0, 4, 4)), []
        return self._runs.index((robot, run))

    # --- poses

    def poses(self, robot: str) -> list[Corrected]:
        """Return all key frames of the newest run of a robot."""
        return self._corrected(self._nodes[robot])

    def find(self, robot: str, index: int) -> Corrected | None:
        """Return the key frame of an index of the newest run of a robot, None if there is none."""
        nodes = (node for node in reversed(self._nodes[robot]) if self.mapper.store.name(node)[1] == index)
        return next((self._corrected([node])[0] for node in nodes), None)

    def corrections(self, robot: str) -> list[Corrected]:
        """Return the key frames of a robot that have moved, or are new, since this was last asked."""
        poses = self.poses(robot)
        if not poses:
            return []
        now = np.stack([each.pose for each in poses])
        before, maps = self._told[robot], self._told_maps[robot]
        count = len(before)
        off = np.abs(now[:count] - before)
        moved = (off[:, :3, 3].max(axis=1, initial=0.0) > TOLD_SHIFT) | (
            off[:, :3, :3].max(axis=(1, 2), initial=0.0) > TOLD_TURN
        )
        changed = [
            number for number, each in enumerate(poses) if number >= count or moved[number] or maps[number] != each.map
        ]
        told = np.concatenate([before, now[count:]])
        told[changed] = now[changed]
        self._told[robot], self._told_maps[robot] = told, [each.map for each in poses]
        return [poses[number] for number in changed]

    def located(self, robot: str) -> Corrected | None:
        """Return the newest key frame of a robot, None before the first."""
        return next(iter(self._corrected(self._nodes[robot][-1:])), None)

    def covariance(self, robot: str) -> Floats:
        """Return the marginal covariance (6, 6) of the newest key frame: translation, rotation, frame of its sensor."""
        return self.mapper.graph.covariance(self._nodes[robot][-1])

    def team(self, robot: str) -> list[str]:
        """Return the robots that are on the same map as a robot, itself included."""
        own = self.located(robot)
        if own is None:
            return [robot]
        others = {name: self.located(name) for name in self.robots}
        return [name for name, each in others.items() if each is not None and each.map == own.map]

    def optimise(self) -> None:
        """Look for maps that can still be joined, and move all key frames to the most likely poses."""
        self.mapper.finish()

    # --- dense maps

    def update_dense(self, most: int) -> None:
        """Put at most so many key frames that the dense maps lack into them, and tell them where the others are now."""
        graph, store = self.mapper.graph, self.mapper.store
        frames = self._frames()
        for origin in set(self._dense) - {frame.origin for frame in frames.values()}:  # joined with another map
            del self._dense[origin], self._in_dense[origin]
        for node, component in enumerate(graph.component):
            frame = frames[component]
            if frame.origin not in self._dense:
                self._dense[frame.origin], self._in_dense[frame.origin] = dense_map(self.sensor), set()
            dense, known = self._dense[frame.origin], self._in_dense[frame.origin]
            pose = frame.shift @ graph.poses[node]
            if node in known:
                robot, index = store.name(node)
                dense.move(robot, index, pose)
            elif most > 0:
                most -= 1
                known.add(node)
                dense.add(self.mapper.key_frame(node), pose)

    def dense(self, robot: str) -> DenseMap:
        """Return the complete dense map on which a robot is."""
        self.update_dense(len(self.mapper.store))
        if not self._nodes[robot]:
            return dense_map(self.sensor)
        component = self.mapper.graph.component[self._nodes[robot][-1]]
        return self._dense[self._frames()[component].origin]

    def cloud(self, robot: str) -> Cloud:
        """Return the points of the map on which a robot is."""
        return self.dense(robot).cloud()

    def mesh(self, robot: str) -> Mesh:
        """Return the surface of the map on which a robot is."""
        return self.dense(robot).mesh()

    def grid(self, robot: str) -> OccupancyGrid:
        """Return the floor plan of the map on which a robot is, in its level frame."""
        return self.dense(robot).grid()

    def next_goal(self, robot: str) -> Pose | None:
        """Return where the sensor of a robot should go next to see something new, None if there is nothing."""
        own = self.located(robot)
        return None if own is None else self.dense(robot).next_goal(own.pose)

    def write(self, robot: str, directory: Path) -> list[Path]:
        """Write the files of the map on which a robot is; return their paths."""
        ways = {number: [each.pose for each in self.poses(name)] for number, name in enumerate(self.team(robot))}
        return self.dense(robot).write(directory, ways)

    @property
    def runs(self) -> list[tuple[str, str]]:
        """Names of robots and of their runs, by the numbers that the back end uses."""
        return list(self._runs)

    @classmethod
    def resumed(
        cls, robots: Sequence[str], runs: list[tuple[str, str]], sensor: str, mapper: KeyFrameMapper[Any]
    ) -> SharedMap:
        """Return the map of a saved session. Robots that are not among `robots` are kept after them."""
        shared = cls([*robots, *dict.fromkeys(name for name, _ in runs if name not in robots)], sensor)
        shared.mapper.close()
        shared.mapper, shared._runs = mapper, list(runs)
        for node in range(len(mapper.store)):
            number, _ = mapper.store.name(node)
            name = runs[number][0]
            if runs[number] == [each for each in runs if each[0] == name][-1]:
                shared._nodes[name].append(node)
        return shared

    def close(self) -> None:
        """Remove the stored images."""
        self.mapper.close()

    # --- frames

    def _corrected(self, nodes: Sequence[int]) -> list[Corrected]:
        graph, store, frames = self.mapper.graph, self.mapper.store, self._frames()
        found = []
        for node in nodes:
            frame = frames[graph.component[node]]
            found.append(Corrected(store.name(node)[1], store.stamp(node), frame.shift @ graph.poses[node], frame.name))
        return found

    def _frames(self) -> dict[int, _Frame]:
        """Return the frames of all maps by the component of the back end."""
        graph = self.mapper.graph
        # The first key frame of each run, in the order of the names of robots.
        runs = sorted(range(len(self._runs)), key=lambda number: (self.robots.index(self._runs[number][0]), number))
        first = [node for number in runs if (node := self.mapper.first(number)) is not None]
        frames = {}
        for component in sorted(set(graph.component)):
            origin = next((node for node in first if graph.component[node] == component), component)
            name = MAIN if first and origin == first[0] else f"{MAIN}_{origin}"
            frames[component] = _Frame(name, origin, inverse(graph.poses[origin]))
        return frames


@dataclass(frozen=True, slots=True)
class _Frame:
    """Frame of a map.

    Attributes:
        name: Name.
        origin: Node of the key frame that is its origin.
        shift: (4, 4) frame of the component of the back end to this frame.
    """

    name: str
    origin: int
    shift: Pose
