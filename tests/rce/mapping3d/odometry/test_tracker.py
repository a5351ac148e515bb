from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from rce.mapping3d.evaluation.errors import absolute_error
from rce.mapping3d.evaluation.room import QVGA, Faults, SimulatedRecording, sweep
from rce.mapping3d.frames import RgbdFrame
from rce.mapping3d.odometry.tracker import Tracked, Tracker
from rce.mapping3d.poses import Pose, angle, distance


def black(stamp: float) -> RgbdFrame:
    return RgbdFrame(stamp, np.zeros((240, 320, 3), np.uint8), np.zeros((240, 320), np.float32))


def tracked_path(answers: list[Tracked]) -> list[Pose]:
    keys: dict[int, Pose] = {-1: np.eye(4)}
    path = []
    for answer in answers:
        path.append(keys[answer.reference] @ answer.pose)
        if answer.key is not None:
            keys[answer.key.index] = path[-1]
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("speed", "faults"),
    [(1.0, Faults()), (3.0, Faults(blur=0.5)), (1.5, Faults(exposure=0.35, missing=0.3))],
    ids=["calm", "fast and blurred", "exposure and holes"],
)
def test_path_is_followed_to_a_centimetre(speed: float, faults: Faults) -> None:
    recording = SimulatedRecording("room", sweep(1.0, speed), faults)
    tracker = Tracker(recording.camera)
    answers = [tracker.add(frame) for frame in recording]
    assert not any(answer.lost for answer in answers)
    assert absolute_error(tracked_path(answers), [pose for _, pose in recording.way]) < 0.01


def test_key_frames_are_made_by_motion() -> None:
    recording = SimulatedRecording("room", sweep(0.4, 2.0))
    tracker = Tracker(recording.camera)
    answers = [tracker.add(frame) for frame in recording]
    assert answers[0].key is not None
    assert not answers[0].linked
    for answer in answers[1:]:
        far = angle(answer.pose) > math.radians(2.9) or distance(answer.pose) > 0.088
        assert (answer.key is not None) <= far


def test_standing_camera_makes_one_key_frame() -> None:
    stamp, pose = sweep(0.1)[0]
    recording = SimulatedRecording("room", tuple((stamp + 0.03 * k, pose) for k in range(4)))
    tracker = Tracker(QVGA)
    answers = [tracker.add(frame) for frame in recording]
    assert [answer.key is not None for answer in answers] == [True, False, False, False]
    assert distance(answers[-1].pose) < 0.003


def test_frame_without_depth_cannot_be_the_first() -> None:
    answer = Tracker(QVGA).add(black(0.0))
    assert answer.lost
    assert (answer.reference, answer.key) == (-1, None)


def test_covered_camera_is_lost_and_finds_its_key_frame_again() -> None:
    frames = list(SimulatedRecording("room", sweep(0.2)))
    tracker = Tracker(QVGA)
    for frame in frames[:3]:
        tracker.add(frame)
    assert tracker.add(black(0.1)).lost
    assert tracker.lost
    again = tracker.add(replace(frames[4], stamp=0.2))
    assert not again.lost
    assert not tracker.lost


def test_jump_is_recovered_by_features() -> None:
    way = sweep(0.6, 2.0)
    jump = (way[0], way[14])
    tracker = Tracker(QVGA)
    answers = [tracker.add(frame) for frame in SimulatedRecording("room", jump)]
    assert not answers[1].lost
    assert absolute_error(
        [*tracked_path(answers), np.eye(4)], [pose for _, pose in jump] + [jump[0][1]]
    ) == pytest.approx(0.0, abs=0.01)


def test_lost_camera_begins_anew_in_another_place() -> None:
    here, there = sweep(0.1)[0], sweep(0.1, begin=9.0)[0]
    way = (here, *((0.1 + 0.03 * k, there[1]) for k in range(12)))
    tracker = Tracker(QVGA)
    answers = [tracker.add(frame) for frame in SimulatedRecording("room", way)]
    begun = [answer for answer in answers[1:] if answer.key is not None]
    assert [answer.linked for answer in begun] == [False]
    assert not answers[-1].lost
    assert answers[-1].reference == 1
