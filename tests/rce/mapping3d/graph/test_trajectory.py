from __future__ import annotations

from functools import partial

import numpy as np

from rce.mapping3d.evaluation.room import QVGA
from rce.mapping3d.frames import KeyFrame
from rce.mapping3d.graph.mapper import Mapper3d
from rce.mapping3d.graph.trajectory import Trajectory
from rce.mapping3d.odometry.tracker import Tracked
from rce.mapping3d.poses import make_pose
from tests.support.rgbd import simulated

KEY = KeyFrame(0, 0, next(iter(simulated())), QVGA)
NONE = np.zeros((6, 6))


def right(metres: float) -> np.ndarray:  # type: ignore[type-arg]
    return make_pose(np.eye(3), (metres, 0.0, 0.0))


def test_frames_without_track_are_between_those_with() -> None:
    mapper, trajectory = Mapper3d(), Trajectory()
    answers = [
        Tracked(0.0, -1, np.eye(4), NONE, lost=True),
        Tracked(1.0, -1, np.eye(4), NONE, key=KEY, linked=False),
        Tracked(2.0, 0, right(9.0), NONE, lost=True),
        Tracked(3.0, 0, right(2.0), NONE),
        Tracked(4.0, 0, right(9.0), NONE, lost=True),
    ]
    for answer in answers:
        mapper.add(answer)
        trajectory.add(answer)
    assert [pose[0, 3] for _, pose in trajectory.poses(partial(mapper.pose, 0))] == [0.0, 0.0, 1.0, 2.0, 2.0]
    assert len(trajectory) == 5
    mapper.close()


def test_robot_without_key_frames_has_no_trajectory() -> None:
    mapper, trajectory = Mapper3d(), Trajectory()
    trajectory.add(Tracked(0.0, -1, np.eye(4), NONE, lost=True))
    assert trajectory.poses(partial(mapper.pose, 0)) == []
    mapper.close()
