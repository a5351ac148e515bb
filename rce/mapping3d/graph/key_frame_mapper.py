"""Back end of any sensor: a map of the key frames of robots, whose maps become one where they see the same place."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO, Generic, Self, TypeVar

import numpy as np

from rce.errors import InvalidRequest
from rce.mapping3d.camera import Camera
from rce.mapping3d.frames import AnyKeyFrame, CloudKeyFrame, KeyFrame
from rce.mapping3d.graph.pose_graph import Edge, Floats, PoseGraph
from rce.mapping3d.graph.state import (
    NO_CAMERA,
    NUMBERS,
    POSE,
    SavedGuess,
    SavedKeyFrame,
    SavedMapper,
    edge_of,
    matrix,
    saved_edge,
)
from rce.mapping3d.graph.store import KeyFrameStore, Packed, pack
from rce.mapping3d.odometry.tracker import Tracked
from rce.mapping3d.poses import Pose, angle, distance, inverse

K = TypeVar("K", KeyFrame, CloudKeyFrame)


@dataclass(frozen=True, slots=True)
class JoiningSettings:
    """Times at which maps are optimised and joined.

    Attributes:
        window: Key frames that move with each new one where no loop was closed.
        bend: Metres and radians by which a loop disagrees with the poses, from which on all of them are optimised.
        consistent: Metres and radians by which two pairs that join maps may differ.
        dense: A view is not indexed if an indexed one is nearer than this: metres, radians.
    """

    window: int = 150
    bend: tuple[float, float] = (0.03, math.radians(1.0))
    consistent: tuple[float, float] = (0.15, math.radians(5.0))
    dense: tuple[float, float] = (0.06, math.radians(2.0))


class KeyFrameMapper(ABC, Generic[K]):
    """Map of the key frames of all robots. Subclasses know how key frames of their sensor are compared.

    Attributes:
        graph: Poses and measured motions; the number of a node is that of its key frame in `store`.
        store: Images or points of the key frames.
        loops: Number of edges that closed a loop or joined maps by appearance.
    """

    def __init__(self, joining: JoiningSettings) -> None:
        """Begin with an empty map."""
        self.graph = PoseGraph()
        self.store = KeyFrameStore()
        self.loops = 0
        self._joining = joining
        self._indexed: list[int] = []
        self._numbers: dict[tuple[int, int], int] = {}  # by robot and index: the node
        self._first: dict[int, int] = {}  # by robot: the node of its first key frame
        self._guesses: dict[int, tuple[int, Pose]] = {}  # by node that begins anew: the one before and a guess
        self._bent = False  # whether a loop that was closed disagrees with the poses
        self._optimised = 0  # key frames of a map when all of it was last optimised
        self._pending: list[tuple[int, int, Edge]] = []  # components and the edge that may join them

    # --- what depends on the sensor

    @abstractmethod
    def key_frame(self, number: int) -> K:
        """Return the key frame of a node."""

    @abstractmethod
    def _prepare(self, number: int, key: AnyKeyFrame) -> None:
        """Prepare a new key frame for what follows.

        Raises:
            InvalidRequest: It is of another sensor.
        """

    @abstractmethod
    def _align_with_neighbours(self, number: int) -> int:
        """Add edges to key frames near the expected pose; return their number."""

    @abstractmethod
    def _recognise(self, number: int) -> int:
        """Add edges to key frames that look alike and were not expected to be near; return their number."""

    @abstractmethod
    def _add_to_index(self, number: int) -> None:
        """Let other key frames be recognised by this one."""

    # --- key frames

    def add(self, tracked: Tracked, packed: Packed | None = None) -> None:
        """Add the key frame of an answer of a front end to the map.

        Args:
            tracked: The answer; without a key frame nothing happens.
            packed: The key frame as it came, compressed; None if it was not compressed yet.
        """
        key = tracked.key
        if key is None:
            return
        self._prepare(len(self.store), key)
        number = self.store.add(packed or pack(key))
        before = self._numbers.get((key.robot, tracked.reference))
        self._numbers[key.robot, key.index] = number
        self._first.setdefault(key.robot, number)
        if before is not None and tracked.linked:
            expected = self.graph.poses[before] @ tracked.pose
            self.graph.add_node(expected, self.graph.component[before])
            self.graph.add_edge(Edge(before, number, tracked.pose, tracked.information, loop=False))
        else:
            self.graph.add_node(np.eye(4), None)
            if before is not None:
                self._guesses[number] = (before, tracked.pose)
        found = self._align_with_neighbours(number)
        found += self._recognise(number)
        self._index_view(number)
        if found:
            self._optimise(self.graph.component[number])

    def has(self, robot: int, index: int) -> bool:
        """Return whether a key frame is on a map."""
        return (robot, index) in self._numbers

    def first(self, robot: int) -> int | None:
        """Return the node of the first key frame of a robot, None if there is none."""
        return self._first.get(robot)

    def pose(self, robot: int, index: int) -> Pose:
        """Return the pose of a key frame in the frame of its map."""
        return self.graph.poses[self._numbers[robot, index]]

    def covariance(self, robot: int, index: int) -> Floats:
        """Return the marginal covariance (6, 6) of a key frame: translation, rotation, frame of its sensor."""
        return self.graph.covariance(self._numbers[robot, index])

    def map_of(self, robot: int, index: int) -> int:
        """Return the number of the map that a key frame is in; 0 is that of the first key frame."""
        return self.graph.component[self._numbers[robot, index]]

    def key_frames(self, number: int = 0) -> Iterator[tuple[K, Pose]]:
        """Yield the key frames of a map with their poses."""
        for node in self.graph.members(number):
            yield self.key_frame(node), self.graph.poses[node]

    def finish(self) -> None:
        """Look for maps that can still be joined, place those of a robot that cannot by a guess, and optimise."""
        for node in [node for node in self._indexed if self.graph.component[node] != self.graph.component[0]]:
            self._recognise(node)
        for node, (before, guess) in self._guesses.items():
            if self.graph.component[node] != self.graph.component[before]:
                unknown = np.diag([4.0] * 3 + [1.0] * 3)
                self.graph.add_edge(Edge(before, node, guess, unknown, loop=True))
        for component in sorted(set(self.graph.component)):
            self.graph.optimise(component)

    def saved(self) -> SavedMapper:
        """Return the state without the images or points, which `store` has."""
        indexed = set(self._indexed)
        frames = []
        for node, (pose, component) in enumerate(zip(self.graph.poses, self.graph.component, strict=True)):
            (robot, index), stamp, content = (
                self.store.name(node),
                self.store.stamp(node),
                pose.astype(NUMBERS).tobytes(),
            )
            camera, (color, depth, cloud) = self.store.camera(node), self.store.sizes()[node]
            intrinsics = camera.numbers if camera else NO_CAMERA
            indexable = node in indexed
            frames.append(
                SavedKeyFrame(robot, index, stamp, intrinsics, color, depth, content, component, indexable, cloud)
            )
        guesses = [
            SavedGuess(node, before, pose.astype(NUMBERS).tobytes()) for node, (before, pose) in self._guesses.items()
        ]
        pending = [(first, second, saved_edge(edge)) for first, second, edge in self._pending]
        return SavedMapper(self.loops, frames, [saved_edge(edge) for edge in self.graph.edges], guesses, pending)

    def resume(self, saved: SavedMapper, images: IO[bytes]) -> Self:
        """Continue a saved state in a mapper that is empty so far. What is found in the images is found anew.

        Args:
            saved: The state.
            images: Images or points of the key frames, as `KeyFrameStore.copy_to` writes them.

        Raises:
            InvalidRequest: State or images are damaged.
        """
        count = len(saved.key_frames)
        for node, frame in enumerate(saved.key_frames):
            color, depth, cloud = (images.read(size) for size in (frame.color, frame.depth, frame.cloud))
            camera = Camera(*frame.camera) if frame.camera != NO_CAMERA else None
            self.store.add(Packed(frame.robot, frame.index, frame.stamp, camera, color, depth, cloud))
            if not 0 <= frame.component <= node:
                raise InvalidRequest("the session is damaged: a key frame is on no map")
            self.graph.add_node(matrix(frame.pose, POSE), frame.component if frame.component < node else None)
            self._numbers[frame.robot, frame.index] = node
            self._first.setdefault(frame.robot, node)
            if frame.indexed:
                self._add_to_index(node)
                self._indexed.append(node)
        self.graph.edges = [edge_of(edge, count) for edge in saved.edges]
        self._guesses = {
            guess.node: (guess.before, matrix(guess.pose, POSE))
            for guess in saved.guesses
            if 0 <= guess.before < guess.node < count
        }
        self._pending = [(first, second, edge_of(edge, count)) for first, second, edge in saved.pending]
        self.loops = saved.loops
        return self

    def close(self) -> None:
        """Remove the stored images."""
        self.store.close()

    def _optimise(self, component: int) -> None:
        """Move the newest key frames of a map; all after a loop that bends it, and when a tenth of them is new."""
        members = self.graph.members(component)
        if self._bent or len(members) > 1.1 * self._optimised + self._joining.window:
            self.graph.optimise(component)
            self._bent, self._optimised = False, len(members)
        else:
            self.graph.optimise(component, members[-self._joining.window :])

    def _close(self, edge: Edge, sure: bool) -> int:
        """Add an edge between key frames that look alike; return 1, or 0 if it joins two maps and nothing confirms it.

        Args:
            edge: From an earlier key frame to the new one.
            sure: Whether it needs no other one to join two maps.
        """
        first, second = self.graph.component[edge.first], self.graph.component[edge.second]
        if first != second and not sure and not self._confirmed(edge):
            self._pending.append((first, second, edge))
            return 0
        off = inverse(self.graph.poses[edge.first] @ edge.relative) @ self.graph.poses[edge.second]
        far, turned = self._joining.bend
        self._bent |= first != second or distance(off) > far or angle(off) > turned
        self.graph.add_edge(edge)
        self.loops += 1
        return 1

    def _connected(self, number: int) -> set[int]:
        """Return the nodes to which a node has an edge."""
        ends = [(edge.first, edge.second) for edge in self.graph.edges if number in (edge.first, edge.second)]
        return {each for pair in ends for each in pair} - {number}

    def _confirmed(self, edge: Edge) -> bool:
        """Return whether an earlier pair of key frames joins the same maps in the same way; use that one, too."""
        maps = {self.graph.component[edge.first], self.graph.component[edge.second]}
        for waiting in self._pending:
            earlier = waiting[2]
            if {self.graph.component[earlier.first], self.graph.component[earlier.second]} != maps:
                continue
            same = self.graph.component[earlier.first] == self.graph.component[edge.first]
            first, second = (earlier.first, earlier.second) if same else (earlier.second, earlier.first)
            relative = earlier.relative if same else inverse(earlier.relative)
            # Both edges give the pose of the second map in the first.
            poses = self.graph.poses
            by_earlier = poses[first] @ relative @ inverse(poses[second])
            by_edge = poses[edge.first] @ edge.relative @ inverse(poses[edge.second])
            off = inverse(by_earlier @ poses[edge.second]) @ by_edge @ poses[edge.second]
            far, turned = self._joining.consistent
            if distance(off) < far and angle(off) < turned and edge.second != earlier.second:
                self._pending.remove(waiting)
                self.graph.add_edge(earlier)
                return True
        return False

    def _near(self, number: int, reach: float) -> list[int]:
        """Return the indexed nodes of the same map that are at most `reach` metres from a node, in order."""
        component = self.graph.component[number]
        same = [each for each in self._indexed if self.graph.component[each] == component]
        if not same:
            return []
        away = np.stack([self.graph.poses[each][:3, 3] for each in same]) - self.graph.poses[number][:3, 3]
        return [same[place] for place in np.flatnonzero((away**2).sum(axis=1) <= reach**2).tolist()]

    def _index_view(self, number: int) -> None:
        """Index a view, unless an indexed one of the same map is much the same: memory grows with space, not time."""
        pose = self.graph.poses[number]
        far, turned = self._joining.dense
        for other in self._near(number, far):
            relative = inverse(pose) @ self.graph.poses[other]
            if distance(relative) < far and angle(relative) < turned:
                return
        self._add_to_index(number)
        self._indexed.append(number)
