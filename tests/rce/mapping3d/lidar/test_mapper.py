from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping3d.evaluation.building import spinning
from rce.mapping3d.evaluation.errors import absolute_error
from rce.mapping3d.graph.trajectory import Trajectory
from rce.mapping3d.lidar.mapper import LidarMapper
from rce.mapping3d.lidar.odometry import LidarTracker
from tests.support.key_frames import tracked
from tests.support.sweeps import drive

PATTERN = spinning(16, 240)


@pytest.mark.slow
def test_two_robots_in_a_building_get_one_map() -> None:
    drives = [drive(4.5, PATTERN), drive(4.5, PATTERN, begin=2.0)]
    mapper, paths = LidarMapper(), [Trajectory() for _ in drives]
    for robot, recording in enumerate(drives):
        tracker = LidarTracker(robot)
        for sweep in recording:
            tracked = tracker.add(sweep)
            mapper.add(tracked)
            paths[robot].add(tracked)
    mapper.finish()
    assert [mapper.map_of(robot, 0) for robot in (0, 1)] == [0, 0]
    estimate = [pose for robot, path in enumerate(paths) for _, pose in path.poses(partial(mapper.pose, robot))]
    truth = [pose for recording in drives for _, pose in recording.way[:-1]]
    assert absolute_error(estimate, truth) < 0.05
    assert (np.linalg.eigvalsh(mapper.covariance(1, 0)) > 0).all()
    assert all(len(key.points) > 500 for key, _ in mapper.key_frames())
    mapper.close()


def test_key_frame_of_a_camera_is_refused() -> None:
    mapper = LidarMapper()
    with pytest.raises(InvalidRequest, match="start a mapper for cameras"):
        mapper.add(tracked(0))
    assert len(mapper.store) == 0
    mapper.close()
