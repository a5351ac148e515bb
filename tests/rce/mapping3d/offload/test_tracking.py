from __future__ import annotations

import numpy as np
import pytest

from rce.mapping3d.evaluation.errors import absolute_error
from rce.mapping3d.evaluation.room import QVGA, SimulatedRecording, sweep
from rce.mapping3d.graph.trajectory import Trajectory
from rce.mapping3d.offload.messages import decode
from rce.mapping3d.offload.sending import Sending
from rce.mapping3d.offload.shared_map import SharedMap
from rce.mapping3d.offload.tracking import RobotTracking
from rce.mapping3d.poses import distance, inverse
from tests.support.key_frames import right
from tests.support.rgbd import CLEAN, simulated


def microseconds(stamp: float) -> int:
    return round(stamp * 1e6)


def carry(now: float, robot: RobotTracking, sending: Sending, shared: SharedMap) -> None:
    """Carry what is due to the cloud, and its answers back."""
    for stamp, _, data in sending.due(robot.outbox, now):
        assert shared.add("a", decode(data))
        sending.answered(robot.outbox, microseconds(stamp), now)
    robot.correct({microseconds(each.stamp): (each.pose, each.map) for each in shared.corrections("a")})


def test_robot_without_a_cloud_tracks_from_its_first_frame() -> None:
    robot, recording = RobotTracking(QVGA), simulated(0.4, 2.0, CLEAN)
    poses = [robot.add(frame).pose for frame in recording]
    truth = [pose for _, pose in recording.way]
    assert absolute_error(poses, truth) < 0.01
    assert len(robot.outbox) == robot.key_frames > 1


@pytest.mark.slow
def test_pose_follows_what_the_cloud_tells_of_an_earlier_key_frame() -> None:
    robot, recording = RobotTracking(QVGA), simulated(0.4, 2.0, CLEAN)
    frames = list(recording)
    for frame in frames:
        last = robot.add(frame)
    first = robot.outbox.after(-1)
    assert first is not None
    robot.correct({microseconds(first.stamp): (right(0.5), "map_7"), 123: (right(9.0), "nowhere")})
    assert robot.map == "map_7"
    np.testing.assert_allclose(robot.key_pose(first.index), right(0.5))
    before = robot.add(frames[-1])
    assert distance(inverse(last.pose) @ before.pose) < 0.01, "no jump"
    for later in range(1, 100):
        frame = frames[-1]
        after = robot.add(type(frame)(frame.stamp + later / 30, frame.color, frame.depth))
    assert after.pose[0, 3] - last.pose[0, 3] == pytest.approx(0.5, abs=0.02)


@pytest.mark.slow
def test_robot_whose_line_is_cut_for_20_seconds_goes_on_and_its_map_grows_together() -> None:
    way = sweep(24.0, 0.3, rate=2.5)
    errors, counts = [], []
    for cut in (False, True):
        shared, robot, path, sending = SharedMap(["a"]), RobotTracking(QVGA, memory=4 << 20), Trajectory(), Sending()
        for frame in SimulatedRecording("room", way):
            path.add(robot.add(frame).tracked)
            if cut and 2.0 < frame.stamp < 22.0:
                continue
            carry(frame.stamp, robot, sending, shared)
        for later in range(1000):
            carry(way[-1][0] + later, robot, sending, shared)
            if not len(robot.outbox):
                break
        shared.optimise()
        robot.correct({microseconds(each.stamp): (each.pose, each.map) for each in shared.poses("a")})
        poses = [pose for _, pose in path.poses(robot.key_pose)]
        errors.append(absolute_error(poses, [pose for _, pose in way]))
        counts.append((len(shared.mapper.store), robot.key_frames - robot.outbox.left_out))
        shared.close()
    assert errors[1] <= 1.5 * errors[0] + 0.001
    assert all(stored == sent for stored, sent in counts), "nothing doubled"
