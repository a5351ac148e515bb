"""Recordings of topics."""

from __future__ import annotations

import time
from pathlib import Path
from typing import cast

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from endpoints.bridge.local_ros import LocalRos
from endpoints.bridge.recorder import Recording
from rce.errors import InvalidRequest

WITHOUT_TOPICS = cast(LocalRos, None)


async def test_second_recording_within_same_second_is_rejected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "strftime", lambda format: "20260101-000000")
    recording = await Recording.begin(WITHOUT_TOPICS, {}, tmp_path)
    with pytest.raises(InvalidRequest, match="20260101-000000"):
        await Recording.begin(WITHOUT_TOPICS, {}, tmp_path)
    recording.end()


async def test_directory_that_cannot_be_written_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InvalidRequest, match="file"):
        await Recording.begin(WITHOUT_TOPICS, {}, tmp_path / "file")
