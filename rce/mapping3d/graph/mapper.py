"""Back end of cameras with depth: how key frames are aligned and recognised."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from rce.errors import InvalidRequest
from rce.mapping3d.frames import AnyKeyFrame, KeyFrame
from rce.mapping3d.graph.key_frame_mapper import JoiningSettings, KeyFrameMapper
from rce.mapping3d.graph.pose_graph import Edge
from rce.mapping3d.graph.views import View, Views
from rce.mapping3d.odometry.alignment import align
from rce.mapping3d.places.index import PlaceIndex
from rce.mapping3d.places.verification import agrees, match_features, refine
from rce.mapping3d.poses import angle, distance, inverse


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
        joining: When maps are optimised and joined.
    """

    neighbours: int = 4
    reach: float = 0.6
    turn: float = math.radians(25.0)
    apart: int = 3
    surprise: tuple[float, float] = (0.15, math.radians(8.0))
    candidates: int = 4
    score: float = 0.03
    sure: int = 60
    joining: JoiningSettings = field(default_factory=JoiningSettings)


class Mapper3d(KeyFrameMapper[KeyFrame]):
    """Map of the key frames of cameras."""

    def __init__(self, settings: MapperSettings | None = None) -> None:
        """Begin with an empty map."""
        self._settings = settings or MapperSettings()
        super().__init__(self._settings.joining)
        self._views = Views(self.store)
        self._index = PlaceIndex()

    def key_frame(self, number: int) -> KeyFrame:
        """Return the key frame of a node."""
        return self.store.key_frame(number)

    def _prepare(self, number: int, key: AnyKeyFrame) -> None:
        if not isinstance(key, KeyFrame):
            raise InvalidRequest("a key frame of a lidar cannot be put on a map of cameras: start a mapper for lidars")
        self._views.add(number, key)

    def _add_to_index(self, number: int) -> None:
        self._index.add(number, self._views[number].features)

    def _align_with_neighbours(self, number: int) -> int:
        view, count = self._views[number], 0
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
        pose = self.graph.poses[number]
        near = []
        for other in self._near(number, self._settings.reach):
            if other == number:
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

    def _recognise(self, number: int) -> int:
        view = self._views[number]
        ranked = self._index.query(view.features)
        best = ranked[0][1] if ranked else 0.0
        known = self._connected(number)
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
        return self._close(edge, match.inliers >= self._settings.sure)
