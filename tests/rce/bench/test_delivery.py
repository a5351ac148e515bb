"""Bytes of messages by the options of an interface."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("av", reason="needs PyAV: pip install '.[video]'")

from rce.bench.delivery import CASES, Figures, as_text, measure, sources
from rce.errors import InvalidRequest
from tests.support.fake_platform import FakePlatform


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    depth = np.full((48, 64), 2000, np.uint16)
    for number in range(2):
        cv2.imwrite(str(tmp_path / f"frame-{number}.color.png"), np.zeros((48, 64, 3), np.uint8))
        cv2.imwrite(str(tmp_path / f"frame-{number}.depth.png"), depth)
    return tmp_path


async def test_messages_of_each_case_are_sent_and_counted(recording: Path) -> None:
    found = sources(recording, 2)
    assert {case.messages for case in CASES} == set(found)
    assert len(found["cloud"].values[0]["data"]) == 48 * 64 * 12
    cases = [case for case in CASES if case.messages == "odometry"][:2]
    async with FakePlatform() as platform, platform.robot() as robot:
        first, slower = await measure(robot, found, cases)
    assert (first.bytes, first.rate, first.saved) == (slower.bytes, 30.0, 0.0)
    assert (slower.rate, round(slower.saved, 3)) == (10.0, 0.667)


def test_recording_without_images_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="no pairs"):
        sources(tmp_path, 1)


def test_table_has_bytes_of_a_message_and_of_a_second() -> None:
    table = as_text([Figures("scan", "JSON", 20_000, 30, 0.0), Figures("scan", "CBOR", 5_000, 30, 0.75)])
    assert "20,000" in table
    assert "150.0" in table
    assert "75.0%" in table
