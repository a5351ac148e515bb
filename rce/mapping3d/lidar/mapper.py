"""Back end of lidars: how key frames are aligned and recognised."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from rce.errors import InvalidRequest
from rce.mapping3d.frames import AnyKeyFrame, CloudKeyFrame
from rce.mapping3d.graph.key_frame_mapper import JoiningSettings, KeyFrameMapper
from rce.mapping3d.graph.pose_graph import Edge
from rce.mapping3d.graph.store import unpack_cloud
from rce.mapping3d.lidar.registration import Registration, Surface, register
from rce.mapping3d.lidar.scan_context import ContextIndex, descriptor
from rce.mapping3d.poses import Pose, angle, distance, inverse, make_pose

MAX_SURFACES = 40  # in memory, about 1 MB each


@dataclass(frozen=True, slots=True)
class LidarMapperSettings:
    """Settings of the back end.

    Attributes:
        neighbours: Key frames near the expected pose with which a new one is aligned.
        reach: Metres, how far these may be away.
        apart: Neighbours differ at least by so many key frames.
        surprise: Metres and radians by which an alignment with a neighbour may differ from the expected pose.
        candidates: Key frames that look alike, which are verified.
        similar: Least similarity of these.
        overlap: Least share of the points of one cloud that are near the other.
        fit: Least share of these that agree, where the pose was known beforehand.
        strict: The same of clouds that look alike, both ways.
        drift: Metres by which two key frames of a map that look alike may be out of their places: at least so many, and
            so many more for each key frame of the map.
        sure: Fit both ways from which on one pair of key frames joins two maps; with less, a second pair must agree.
        joining: When maps are optimised and joined.
    """

    neighbours: int = 3
    reach: float = 3.0
    apart: int = 4
    surprise: tuple[float, float] = (0.5, math.radians(6.0))
    candidates: int = 5
    similar: float = 0.7
    overlap: float = 0.5
    fit: float = 0.7
    strict: float = 0.8
    drift: tuple[float, float] = (1.0, 0.03)
    sure: float = 0.97
    joining: JoiningSettings = field(
        default_factory=lambda: JoiningSettings(
            bend=(0.1, math.radians(1.0)), consistent=(0.3, math.radians(4.0)), dense=(0.4, math.radians(15.0))
        )
    )


class LidarMapper(KeyFrameMapper[CloudKeyFrame]):
    """Map of the key frames of lidars."""

    def __init__(self, settings: LidarMapperSettings | None = None) -> None:
        """Begin with an empty map."""
        self._settings = settings or LidarMapperSettings()
        super().__init__(self._settings.joining)
        self._surfaces: OrderedDict[int, Surface] = OrderedDict()
        self._index = ContextIndex()

    def key_frame(self, number: int) -> CloudKeyFrame:
        """Return the key frame of a node."""
        return unpack_cloud(self.store.packed(number))

    def _prepare(self, number: int, key: AnyKeyFrame) -> None:
        if not isinstance(key, CloudKeyFrame):
            raise InvalidRequest("a key frame of a camera cannot be put on a map of lidars: start a mapper for cameras")
        self._keep(number, Surface(key.points))

    def _add_to_index(self, number: int) -> None:
        self._index.add(number, descriptor(self._surface(number)))

    def _align_with_neighbours(self, number: int) -> int:
        count = 0
        for other in self._neighbours(number):
            expected = inverse(self.graph.poses[other]) @ self.graph.poses[number]
            found = register(self._surface(other), self._surface(number), expected, (0.6, 0.3))
            off = inverse(expected) @ found.pose
            far, turned = self._settings.surprise
            if self._agrees(found, self._settings.fit) and distance(off) < far and angle(off) < turned:
                self.graph.add_edge(Edge(other, number, found.pose, found.information, loop=True))
                count += 1
        return count

    def _neighbours(self, number: int) -> list[int]:
        """Return the nearest indexed key frames of the same map, but not one after the other."""
        pose, component = self.graph.poses[number], self.graph.component[number]
        same = [each for each in self._indexed if self.graph.component[each] == component and each != number]
        if not same:
            return []
        away = np.linalg.norm(np.stack([self.graph.poses[each][:3, 3] for each in same]) - pose[:3, 3], axis=1)
        chosen: list[int] = []
        for place in np.argsort(away).tolist():
            if len(chosen) == self._settings.neighbours or away[place] > self._settings.reach:
                break
            if all(abs(same[place] - each) > self._settings.apart for each in (*chosen, number)):
                chosen.append(same[place])
        return chosen

    def _recognise(self, number: int) -> int:
        count = tried = 0
        known = self._connected(number)
        for other, similarity, yaw in self._index.query(descriptor(self._surface(number))):
            if tried == self._settings.candidates or similarity < self._settings.similar or count:
                break
            if other == number or other in known or self._expected(number, other):
                continue
            tried += 1
            count += self._verify(number, other, make_pose(Rotation.from_euler("z", yaw).as_matrix(), (0, 0, 0)))
        return count

    def _expected(self, number: int, other: int) -> bool:
        """Return whether two key frames are near by their poses, which `_align_with_neighbours` has handled."""
        if self.graph.component[number] != self.graph.component[other]:
            return False
        return distance(inverse(self.graph.poses[number]) @ self.graph.poses[other]) < self._settings.reach

    def _verify(self, number: int, other: int, start: Pose) -> int:
        """Add the edge to a key frame that looks alike, if it shows the same place; return the number of edges."""
        found = register(self._surface(other), self._surface(number), start)
        if not self._agrees(found, self._settings.strict):
            return 0
        if not self._plausible(number, other, found.pose):
            return 0
        back = register(self._surface(number), self._surface(other), inverse(found.pose), (0.3,))
        if not self._agrees(back, self._settings.strict):
            return 0
        edge = Edge(other, number, found.pose, found.information, loop=True)
        return self._close(edge, min(found.fit, back.fit, found.overlap, back.overlap) > self._settings.sure)

    def _plausible(self, number: int, other: int, relative: Pose) -> bool:
        """Return whether the map can be so wrong: corridors and rooms of a building look alike."""
        component = self.graph.component[number]
        if component != self.graph.component[other]:
            return True
        off = inverse(self.graph.poses[other] @ relative) @ self.graph.poses[number]
        least, more = self._settings.drift
        return distance(off) < least + more * len(self.graph.members(component))

    def _agrees(self, found: Registration, fit: float) -> bool:
        return found.overlap >= self._settings.overlap and found.fit >= fit

    def _surface(self, number: int) -> Surface:
        if number in self._surfaces:
            self._surfaces.move_to_end(number)
            return self._surfaces[number]
        return self._keep(number, Surface(self.key_frame(number).points))

    def _keep(self, number: int, surface: Surface) -> Surface:
        self._surfaces[number] = surface
        while len(self._surfaces) > MAX_SURFACES:
            self._surfaces.popitem(last=False)
        return surface
