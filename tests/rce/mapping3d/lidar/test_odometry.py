from __future__ import annotations

import numpy as np
import pytest

from rce.mapping.clouds import Sweep
from rce.mapping3d.evaluation.building import Pattern, solid_state, spinning
from rce.mapping3d.evaluation.errors import trajectory_error
from rce.mapping3d.lidar.odometry import LidarTracker
from rce.mapping3d.poses import Pose
from tests.support.sweeps import drive

NOTHING = Sweep(0.0, np.empty((0, 3), np.float32), np.empty(0))


@pytest.mark.slow
@pytest.mark.parametrize("pattern", [spinning(16, 240), solid_state(3000)], ids=lambda each: each.name)
def test_moving_lidar_is_tracked_while_it_measures(pattern: Pattern) -> None:
    recording, tracker = drive(3.5, pattern), LidarTracker()
    keys: dict[int, Pose] = {-1: np.eye(4)}
    path = []
    for sweep in recording:
        tracked = tracker.add(sweep)
        assert not tracked.lost
        path.append((tracked.stamp, keys[tracked.reference] @ tracked.pose))
        if tracked.key is not None:
            keys[tracked.key.index] = path[-1][1]
            assert tracked.key.stamp == sweep.stamp
    assert len(keys) > 3
    error = trajectory_error(path, recording.way)
    assert error.absolute < 0.03
    assert (np.diag(tracked.information) > 0).all()


def test_sweeps_without_points_lose_track_and_the_front_end_begins_anew() -> None:
    sweeps = list(drive(0.2, spinning(16, 180)))
    tracker = LidarTracker()
    assert tracker.add(NOTHING).lost
    first = tracker.add(sweeps[0])
    assert first.key is not None
    assert not first.linked
    lost = [tracker.add(NOTHING) for _ in range(10)]
    assert all(each.lost and each.reference == 0 for each in lost)
    assert tracker.lost
    again = tracker.add(sweeps[1])
    assert again.key is not None
    assert (again.key.index, again.reference, again.linked) == (1, 0, False)
