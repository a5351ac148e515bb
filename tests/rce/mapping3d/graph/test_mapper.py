from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from rce.mapping3d.evaluation.errors import absolute_error
from rce.mapping3d.evaluation.room import QVGA, Faults, SimulatedRecording, sweep
from rce.mapping3d.files.trajectories import Stamped
from rce.mapping3d.graph.mapper import Mapper3d
from rce.mapping3d.graph.trajectory import Trajectory
from rce.mapping3d.odometry.tracker import Tracker

Way = tuple[Stamped, ...]


def mapped(ways: list[Way], faults: Faults | None = None) -> tuple[Mapper3d, list[list[Stamped]]]:
    mapper, paths = Mapper3d(), [Trajectory() for _ in ways]
    trackers = [Tracker(QVGA, robot) for robot, _ in enumerate(ways)]
    streams = [SimulatedRecording("room", way, faults or Faults()) for way in ways]
    for robot, recording in enumerate(streams):
        for frame in recording:
            tracked = trackers[robot].add(frame)
            mapper.add(tracked)
            paths[robot].add(tracked)
    mapper.finish()
    return mapper, [path.poses(partial(mapper.pose, robot)) for robot, path in enumerate(paths)]


@pytest.mark.slow
def test_two_robots_that_see_the_same_place_get_one_map() -> None:
    ways = [sweep(1.0, 2.0), sweep(1.0, 2.0, begin=1.2)]
    mapper, paths = mapped(ways)
    assert [mapper.map_of(robot, 0) for robot in (0, 1)] == [0, 0]
    estimate = [pose for path in paths for _, pose in path]
    assert absolute_error(estimate, [pose for way in ways for _, pose in way]) < 0.01
    assert len(list(mapper.key_frames())) == len(mapper.store)
    mapper.close()


@pytest.mark.slow
def test_robots_that_see_different_places_keep_their_own_maps() -> None:
    mapper, paths = mapped([sweep(0.3), sweep(0.3, begin=9.0)])
    assert mapper.map_of(0, 0) != mapper.map_of(1, 0)
    for path in paths:
        np.testing.assert_allclose(path[0][1], np.eye(4), atol=1e-6)
    mapper.close()


@pytest.mark.slow
def test_lost_robot_is_found_again_on_the_map() -> None:
    # The camera jumps to a place that its key frame does not show, and comes back later.
    way, away = sweep(0.4), sweep(0.5, begin=9.0)
    shifted = [(stamp + 1.0, pose) for stamp, pose in away]
    back = [(stamp + 2.0, pose) for stamp, pose in sweep(0.5, begin=0.2)]
    mapper, (path,) = mapped([(*way, *shifted, *back)])
    estimate = [pose for stamp, pose in path if stamp < 0.4 or stamp > 2.35]
    truth = [pose for stamp, pose in (*way, *back) if stamp < 0.4 or stamp > 2.35]
    assert absolute_error(estimate, truth) < 0.02
    mapper.close()


def test_uncertainty_of_a_key_frame_is_small_and_positive() -> None:
    mapper, _ = mapped([sweep(0.3, 2.0)])
    covariance = mapper.covariance(0, len(mapper.store) - 1)
    assert (np.linalg.eigvalsh(covariance) > 0).all()
    assert np.sqrt(covariance.diagonal()[:3]).max() < 0.05
    mapper.close()
