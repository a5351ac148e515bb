from __future__ import annotations

import zipfile
from pathlib import Path

import msgspec
import numpy as np
import pytest

from rce.errors import InvalidRequest, NotFound
from rce.mapping3d.evaluation.room import QVGA, SimulatedRecording, sweep
from rce.mapping3d.odometry.tracker import Tracker
from rce.mapping3d.offload.messages import message_of
from rce.mapping3d.offload.sessions import IMAGES, STATE, SavedSession, resume_session, save_session
from rce.mapping3d.offload.shared_map import SharedMap
from tests.support.key_frames import key_frame
from tests.support.rgbd import CLEAN


@pytest.mark.slow
def test_resumed_session_continues_as_the_saved_one(tmp_path: Path) -> None:
    tracker = Tracker(QVGA)
    answers = [tracker.add(frame) for frame in SimulatedRecording("room", sweep(0.8, 2.0), CLEAN)]
    messages = [message_of("run", answer) for answer in answers if answer.key is not None]
    half = len(messages) // 2
    shared = SharedMap(["a"])
    for message in messages[:half]:
        shared.add("a", message)
    save_session(shared, tmp_path / "session")
    resumed = resume_session(tmp_path / "session", ["b", "a"])
    assert resumed.robots == ["b", "a"]
    for message in messages[half:]:
        assert shared.add("a", message)
        assert resumed.add("a", message)
    for before, after in zip(shared.poses("a"), resumed.poses("a"), strict=True):
        np.testing.assert_allclose(after.pose, before.pose, atol=1e-6)
    assert len(resumed.cloud("a").points) == pytest.approx(len(shared.cloud("a").points), rel=0.01)
    shared.close()
    resumed.close()


def saved(path: Path) -> Path:
    shared = SharedMap(["a"])
    shared.add("a", key_frame(0))
    shared.add("a", key_frame(1))
    save_session(shared, path)
    shared.close()
    return path


def test_robots_of_a_session_are_kept(tmp_path: Path) -> None:
    resumed = resume_session(saved(tmp_path / "session"), ["b"])
    assert resumed.robots == ["b", "a"]
    assert len(resumed.poses("a")) == 2
    resumed.close()


def test_missing_session_is_named(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="no such session"):
        resume_session(tmp_path / "none", [])


def test_file_that_is_no_session_is_refused(tmp_path: Path) -> None:
    (tmp_path / "session").write_bytes(b"something else")
    with pytest.raises(InvalidRequest, match="not a session"):
        resume_session(tmp_path / "session", [])


@pytest.mark.parametrize("fault", ["version", "robot", "component", "matrix", "edge", "images"])
def test_damaged_session_is_refused(tmp_path: Path, fault: str) -> None:
    path = saved(tmp_path / "session")
    with zipfile.ZipFile(path) as archive:
        session = msgspec.msgpack.decode(archive.read(STATE), type=SavedSession)
        images = archive.read(IMAGES)
    mapper, replace = session.mapper, msgspec.structs.replace
    first = mapper.key_frames[0]
    changed = {
        "version": replace(session, version=99),
        "robot": replace(session, runs=[]),
        "component": replace(session, mapper=replace(mapper, key_frames=[replace(first, component=7)])),
        "matrix": replace(session, mapper=replace(mapper, key_frames=[replace(first, pose=b"1")])),
        "edge": replace(session, mapper=replace(mapper, edges=[replace(mapper.edges[0], second=9)])),
        "images": session,
    }[fault]
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(STATE, msgspec.msgpack.encode(changed))
        archive.writestr(IMAGES, images[:10] if fault == "images" else images)
    with pytest.raises(InvalidRequest):
        resume_session(path, ["a"])
