"""What all back ends have in common, with a sensor that recognises what it is told to."""

from __future__ import annotations

import io

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping3d.frames import AnyKeyFrame, CloudKeyFrame
from rce.mapping3d.graph.key_frame_mapper import JoiningSettings, KeyFrameMapper
from rce.mapping3d.graph.pose_graph import Edge
from rce.mapping3d.graph.store import unpack_cloud
from rce.mapping3d.odometry.tracker import Tracked
from rce.mapping3d.poses import make_pose

POINTS = np.zeros((3, 3), np.float32)


class Told(KeyFrameMapper[CloudKeyFrame]):
    """Recognises the pairs of nodes in `alike`, all at the same place."""

    def __init__(self) -> None:
        super().__init__(JoiningSettings())
        self.alike: dict[int, int] = {}
        self.sure = True

    def key_frame(self, number: int) -> CloudKeyFrame:
        return unpack_cloud(self.store.packed(number))

    def _prepare(self, number: int, key: AnyKeyFrame) -> None:
        pass

    def _align_with_neighbours(self, number: int) -> int:
        return 0

    def _recognise(self, number: int) -> int:
        other = self.alike.get(number)
        if other is None or other in self._connected(number):
            return 0
        return self._close(Edge(other, number, np.eye(4), 1e4 * np.eye(6), loop=True), self.sure)

    def _add_to_index(self, number: int) -> None:
        pass


def step(robot: int, index: int, metres: float = 1.0) -> Tracked:
    key = CloudKeyFrame(robot, index, float(index), POINTS)
    way = make_pose(np.eye(3), (metres, 0, 0))
    return Tracked(float(index), index - 1, way, 1e4 * np.eye(6), key=key, linked=index > 0)


def test_loop_pulls_the_way_together() -> None:
    mapper = Told()
    mapper.alike = {3: 0}
    for index in range(4):
        mapper.add(step(0, index, 0.01))
    assert mapper.loops == 1
    assert 0 < mapper.pose(0, 3)[0, 3] < 0.02, "the way says 0.03 m, the loop 0"
    assert [key.index for key, _ in mapper.key_frames()] == [0, 1, 2, 3]
    mapper.close()


def test_unsure_pair_joins_maps_only_with_a_second_one() -> None:
    mapper = Told()
    mapper.alike, mapper.sure = {2: 0, 3: 1}, False
    for robot, index in ((0, 0), (0, 1), (1, 0)):
        mapper.add(step(robot, index))
    assert mapper.map_of(1, 0) == 2
    mapper.add(step(1, 1))
    assert mapper.map_of(1, 0) == mapper.map_of(1, 1) == 0
    mapper.close()


def test_saved_map_is_resumed() -> None:
    mapper, content = Told(), io.BytesIO()
    for index in range(3):
        mapper.add(step(0, index))
    mapper.store.copy_to(content)
    content.seek(0)
    resumed = Told().resume(mapper.saved(), content)
    np.testing.assert_allclose(resumed.pose(0, 2), mapper.pose(0, 2))
    assert resumed.key_frame(2).points.tolist() == POINTS.tolist()
    assert resumed.saved() == mapper.saved()
    with pytest.raises(InvalidRequest, match="damaged"):
        Told().resume(mapper.saved(), io.BytesIO()).key_frame(0)
    for each in (mapper, resumed):
        each.close()
