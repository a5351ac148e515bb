from __future__ import annotations

from rce.mapping3d.evaluation.room import SimulatedRecording, sweep
from rce.mapping3d.files.recordings.together import together
from tests.support.rgbd import CLEAN


def test_frames_of_all_robots_come_in_the_order_of_time_since_each_began() -> None:
    late = tuple((stamp + 100.0, pose) for stamp, pose in sweep(0.2, rate=15.0))
    late = (*late, late[-1])  # a stamp that comes twice
    recordings = [SimulatedRecording("a", sweep(0.2), CLEAN), SimulatedRecording("b", late, CLEAN)]
    found = [(round(frame.stamp % 100.0, 3), robot) for robot, frame in together(recordings)]
    stamps = [stamp for stamp, _ in found]
    assert stamps == sorted(stamps)
    assert [robot for _, robot in found].count(0) == 6
    assert [robot for _, robot in found].count(1) == 3
