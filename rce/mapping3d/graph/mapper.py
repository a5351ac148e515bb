"""Back end: a map of the key frames of one robot or of several, which grow together where they see the same place."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO

import numpy as np

from rce.errors import InvalidRequest
from rce.mapping3d.camera import Camera
from rce.mapping3d.frames import KeyFrame
from rce.mapping3d.graph.pose_graph import Edge, Floats, PoseGraph
from rce.mapping3d.graph.state import (
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
from rce.mapping3d.graph.views import View, Views
from rce.mapping3d.odometry.alignment import align
from rce.mapping3d.odometry.tracker import Tracked
from rce.mapping3d.places.index import PlaceIndex
from rce.mapping3d.places.verification import agrees, match_features, refine
from rce.mapping3d.poses import Pose, angle, distance, inverse


@dataclass(frozen=True, slots=True)
class MapperSettings:
    """Settings of the back end.

    Attributes:
        neighbours: Key frames near the expected pose with which a new one is aligned.
        reach: Metres, how far these may be away.
        turn: Radians, likewise.
        apart: Neighbours of the same robot differ at least by so many key frames.
        surprise: Metres and radians by which an alignment with a neighbour may differ from the expected pose.
        candidates: Key frames that look alike, which are verified.
        score: Least score of these, as a share of the score of the view itself.
        sure: Inliers of features from which on one pair of key frames joins two maps; with fewer, a second pair must
            agree.
        consistent: Metres and radians by which two pairs that join maps may differ.
        window: Key frames that move with each new one where no loop was closed.
        bend: Metres and radians by which a loop disagrees with the poses, from which on all of them are optimised.
        dense: A view is not indexed if an indexed one is nearer than this: metres, radians.
    """

    neighbours: int = 4
    reach: float = 0.6
    turn: float = math.radians(25.0)
    apart: int = 3
    surprise: tuple[float, float] = (0.15, math.radians(8.0))
    candidates: int = 4
    score: float = 0.03
    sure: int = 60
    consistent: tuple[float, float] = (0.15, math.radians(5.0))
    window: int = 150
    bend: tuple[float, float] = (0.03, math.radians(1.0))
    dense: tuple[float, float] = (0.06, math.radians(2.0))


class Mapper3d:
    """Map of the key frames of all robots.

    Attributes:
        graph: Poses and measured motions; the number of a node is that of its key frame in `store`.
        store: Images of the key frames.
        loops: Number of edges that closed a loop or joined maps by appearance.
    """

    def __init__(self, settings: MapperSettings | None = None) -> None:
        """Begin with an empty map."""
        self.graph = PoseGraph()
        self.store = KeyFrameStore()
        self.loops = 0
        self._settings = settings or MapperSettings()
        self._views = Views(self.store)
        self._index = PlaceIndex()
        self._indexed: list[int] = []
        self._numbers: dict[tuple[int, int], int] = {}  # by robot and index: the node
        self._first: dict[int, int] = {}  # by robot: the node of its first key frame
        self._guesses: dict[int, tuple[int, Pose]] = {}  # by node that begins anew: the one before and a guess
        self._bent = False  # whether a loop that was closed disagrees with the poses
        self._optimised = 0  # key frames of a map when all of it was last optimised
        self._pending: list[tuple[int, int, Edge]] = []  # components and the edge that may join them

    def add(self, tracked: Tracked, packed: Packed | None = None) -> None:
        """Add the key frame of an answer of a front end to the map.

        Args:
            tracked: The answer; without a key frame nothing happens.
            packed: The key frame as it came, compressed; None if it was not compressed yet.
        """
        key = tracked.key
        if key is None:
            return
        number = self.store.add(packed or pack(key))
        view = self._views.add(number, key)
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
        found = self._align_with_neighbours(number, view)
        found += self._recognise(number, view)
        self._index_view(number, view)
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
        """Return the marginal covariance (6, 6) of a key frame: translation, rotation, frame of its camera."""
        return self.graph.covariance(self._numbers[robot, index])

    def map_of(self, robot: int, index: int) -> int:
        """Return the number of the map that a key frame is in; 0 is that of the first key frame."""
        return self.graph.component[self._numbers[robot, index]]

    def key_frames(self, number: int = 0) -> Iterator[tuple[KeyFrame, Pose]]:
        """Yield the key frames of a map with their poses."""
        for node in self.graph.members(number):
            yield self.store.key_frame(node), self.graph.poses[node]

    def finish(self) -> None:
        """Look for maps that can still be joined, place those of a robot that cannot by a guess, and optimise."""
        for node in [node for node in self._indexed if self.graph.component[node] != self.graph.component[0]]:
            self._recognise(node, self._views[node])
        for node, (before, guess) in self._guesses.items():
            if self.graph.component[node] != self.graph.component[before]:
                unknown = np.diag([4.0] * 3 + [1.0] * 3)
                self.graph.add_edge(Edge(before, node, guess, unknown, loop=True))
        for component in sorted(set(self.graph.component)):
            self.graph.optimise(component)

    def saved(self) -> SavedMapper:
        """Return the state without the images, which `store` has."""
        indexed = set(self._indexed)
        frames = []
        for node, (pose, component) in enumerate(zip(self.graph.poses, self.graph.component, strict=True)):
            (robot, index), (color, depth) = self.store.name(node), self.store.sizes()[node]
            intrinsics = self.store.camera(node).numbers
            content = pose.astype(NUMBERS).tobytes()
            stamp = self.store.stamp(node)
            frames.append(
                SavedKeyFrame(robot, index, stamp, intrinsics, color, depth, content, component, node in indexed)
            )
        guesses = [
            SavedGuess(node, before, pose.astype(NUMBERS).tobytes()) for node, (before, pose) in self._guesses.items()
        ]
        pending = [(first, second, saved_edge(edge)) for first, second, edge in self._pending]
        return SavedMapper(self.loops, frames, [saved_edge(edge) for edge in self.graph.edges], guesses, pending)

    @classmethod
    def resumed(cls, saved: SavedMapper, images: IO[bytes], settings: MapperSettings | None = None) -> Mapper3d:
        """Return a mapper in a saved state. Features of the images are found anew.

        Args:
            saved: The state.
            images: Images of the key frames, as `KeyFrameStore.copy_to` writes them.
            settings: As for a new mapper.

        Raises:
            InvalidRequest: State or images are damaged.
        """
        mapper, count = cls(settings), len(saved.key_frames)
        for node, frame in enumerate(saved.key_frames):
            color, depth = images.read(frame.color), images.read(frame.depth)
            mapper.store.add(Packed(frame.robot, frame.index, frame.stamp, Camera(*frame.camera), color, depth))
            if not 0 <= frame.component <= node:
                raise InvalidRequest("the session is damaged: a key frame is on no map")
            mapper.graph.add_node(matrix(frame.pose, POSE), frame.component if frame.component < node else None)
            mapper._numbers[frame.robot, frame.index] = node
            mapper._first.setdefault(frame.robot, node)
            if frame.indexed:
                mapper._index.add(node, mapper._views[node].features)
                mapper._indexed.append(node)
        mapper.graph.edges = [edge_of(edge, count) for edge in saved.edges]
        mapper._guesses = {
            guess.node: (guess.before, matrix(guess.pose, POSE))
            for guess in saved.guesses
            if 0 <= guess.before < guess.node < count
        }
        mapper._pending = [(first, second, edge_of(edge, count)) for first, second, edge in saved.pending]
        mapper.loops = saved.loops
        return mapper

    def close(self) -> None:
        """Remove the stored images."""
        self.store.close()

    def _optimise(self, component: int) -> None:
        """Move the newest key frames of a map; all after a loop that bends it, and when a tenth of them is new."""
        members = self.graph.members(component)
        if self._bent or len(members) > 1.1 * self._optimised + self._settings.window:
            self.graph.optimise(component)
            self._bent, self._optimised = False, len(members)
        else:
            self.graph.optimise(component, members[-self._settings.window :])

    def _align_with_neighbours(self, number: int, view: View) -> int:
        """Add edges to key frames near the expected pose; return their number."""
        count = 0
        for other in self._neighbours(number):
            relative = inverse(self.graph.poses[number]) @ self.graph.poses[other]
            found = align(self._views[other].reference, view.image, relative, first=2)
            off = found.pose @ inverse(relative)
            far, turned = self._settings.surprise
            if agrees(found, strict=False) and distance(off) < far and angle(off) < turned:
                self.graph.add_edge(Edge(other, number, inverse(found.pose), found.information, loop=True))
                count += 1
        return count

    def _neighbours(self, number: int) -> list[int]:
        """Return the nearest indexed key frames of the same map, but not one after the other."""
        pose, component = self.graph.poses[number], self.graph.component[number]
        near = []
        for other in self._indexed:
            if self.graph.component[other] != component or other == number:
                continue
            relative = inverse(pose) @ self.graph.poses[other]
            far, turned = distance(relative) / self._settings.reach, angle(relative) / self._settings.turn
            if max(far, turned) < 1.0:
                near.append((far + turned, other))
        last = {edge.first for edge in self.graph.edges[-1:] if edge.second == number}
        chosen: list[int] = []
        for _, other in sorted(near):
            if len(chosen) == self._settings.neighbours:
                break
            if other not in last and all(abs(other - each) > self._settings.apart for each in chosen):
                chosen.append(other)
        return chosen

    def _recognise(self, number: int, view: View) -> int:
        """Add edges to key frames that look alike and were not expected to be near; return their number."""
        ranked = self._index.query(view.features)
        best = ranked[0][1] if ranked else 0.0
        known = {edge.first for edge in self.graph.edges if edge.second == number}
        known |= {edge.second for edge in self.graph.edges if edge.first == number}
        count = tried = 0
        for other, score in ranked:
            if tried == self._settings.candidates or score < self._settings.score * best:
                break
            if other == number or other in known or self._expected(number, other):
                continue
            tried += 1
            count += self._verify(number, other, view)
            if count:
                break
        return count

    def _expected(self, number: int, other: int) -> bool:
        """Return whether two key frames are neighbours by their poses, which `_align_with_neighbours` has handled."""
        if self.graph.component[number] != self.graph.component[other]:
            return False
        relative = inverse(self.graph.poses[number]) @ self.graph.poses[other]
        return distance(relative) < self._settings.reach and angle(relative) < self._settings.turn

    def _verify(self, number: int, other: int, view: View) -> int:
        """Add the edge to a key frame that looks alike, if it shows the same place; return the number of edges."""
        reference = self._views[other]
        match = match_features(reference.features, view.features, view.key.camera)
        found = refine(match, reference.reference, view.image) if match else None
        if match is None or found is None:
            return 0
        edge = Edge(other, number, inverse(found.pose), found.information, loop=True)
        first, second = self.graph.component[other], self.graph.component[number]
        if first != second and match.inliers < self._settings.sure and not self._confirmed(edge):
            self._pending.append((first, second, edge))
            return 0
        off = inverse(self.graph.poses[other] @ edge.relative) @ self.graph.poses[number]
        far, turned = self._settings.bend
        self._bent |= first != second or distance(off) > far or angle(off) > turned
        self.graph.add_edge(edge)
        self.loops += 1
        return 1

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
            far, turned = self._settings.consistent
            if distance(off) < far and angle(off) < turned and edge.second != earlier.second:
                self._pending.remove(waiting)
                self.graph.add_edge(earlier)
                return True
        return False

    def _index_view(self, number: int, view: View) -> None:
        """Index a view, unless an indexed one of the same map is much the same: memory grows with space, not time."""
        pose, component = self.graph.poses[number], self.graph.component[number]
        far, turned = self._settings.dense
        for other in self._indexed:
            if self.graph.component[other] == component:
                relative = inverse(pose) @ self.graph.poses[other]
                if distance(relative) < far and angle(relative) < turned:
                    return
        self._index.add(number, view.features)
        self._indexed.append(number)
