from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rce.mapping3d.evaluation.room import QVGA, SimulatedRecording, sweep
from rce.mapping3d.odometry.tracker import Tracker
from rce.mapping3d.offload.messages import KeyFrameMessage, message_of
from rce.mapping3d.offload.shared_map import SharedMap
from tests.support.key_frames import key_frame, tracked
from tests.support.rgbd import CLEAN


def key_frames(seconds: float, begin: float, run: str) -> list[KeyFrameMessage]:
    """Return the key frames of a camera in the simulated room."""
    tracker = Tracker(QVGA)
    answers = [tracker.add(frame) for frame in SimulatedRecording("room", sweep(seconds, 2.0, begin), CLEAN)]
    return [message_of(run, answer) for answer in answers if answer.key is not None]


def test_repeated_key_frame_changes_nothing_and_an_early_one_has_to_wait() -> None:
    shared = SharedMap(["a"])
    assert shared.add("a", key_frame(0))
    assert shared.add("a", key_frame(0))
    assert not shared.add("a", key_frame(2))
    assert shared.add("a", key_frame(1))
    assert len(shared.mapper.store) == 2
    shared.close()


def test_robot_is_told_of_new_and_moved_key_frames_once() -> None:
    shared = SharedMap(["a"])
    assert shared.corrections("a") == []
    shared.add("a", key_frame(0))
    shared.add("a", key_frame(1, 0.1))
    assert [each.index for each in shared.corrections("a")] == [0, 1]
    assert shared.corrections("a") == []
    shared.mapper.graph.poses[1][0, 3] += 0.2
    (moved,) = shared.corrections("a")
    assert (moved.index, moved.stamp, moved.map) == (1, 1.0, "map")
    assert moved.pose[0, 3] == pytest.approx(0.3)
    shared.close()


def test_new_run_of_a_robot_is_told_about_its_own_key_frames() -> None:
    shared = SharedMap(["a"])
    shared.add("a", key_frame(0, run="first"))
    shared.add_tracked("a", "second", tracked(0))
    assert [each.map for each in shared.poses("a")] == ["map_1"]
    assert shared.runs == [("a", "first"), ("a", "second")]
    shared.close()


def test_map_before_the_first_key_frame_is_empty() -> None:
    shared = SharedMap(["a", "b"])
    assert shared.located("a") is None
    assert shared.team("b") == ["b"]
    assert shared.next_goal("a") is None
    assert len(shared.cloud("a").points) == 0
    assert (shared.grid("a").cells < 0).all()
    shared.close()


@pytest.mark.slow
def test_robots_that_see_the_same_place_get_one_map_whose_frame_is_that_of_the_first(tmp_path: Path) -> None:
    shared = SharedMap(["a", "b"])
    second, first = key_frames(0.7, 0.9, "2"), key_frames(0.7, 0.0, "1")
    for message in second[:2]:
        assert shared.add("b", message)
    own = shared.located("b")
    assert own is not None
    assert own.map == "map"
    for message in (*first, *second):
        assert shared.add((message.run == "1" and "a") or "b", message)
    shared.optimise()
    assert shared.team("b") == ["a", "b"]
    np.testing.assert_allclose(shared.poses("a")[0].pose, np.eye(4), atol=1e-9)
    assert {each.map for name in ("a", "b") for each in shared.poses(name)} == {"map"}
    assert len(shared.corrections("b")) == len(second)
    assert np.linalg.eigvalsh(shared.covariance("b")).min() > 0
    assert len(shared.cloud("b").points) > 1000
    assert (shared.grid("a").cells == shared.grid("b").cells).all()
    assert {path.name for path in shared.write("b", tmp_path)} >= {"cloud.ply", "mesh.ply", "view.png", "map.yaml"}
    shared.close()
