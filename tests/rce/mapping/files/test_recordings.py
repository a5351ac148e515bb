"""Opening recordings by name, and stamps that increase."""

from __future__ import annotations

from pathlib import Path

import pytest

from rce.errors import InvalidRequest, NotFound
from rce.mapping.files.recordings import open_recording
from tests.support.recordings import WRITERS, carmen, flaser


def test_invalid_stamps_are_made_to_increase(tmp_path: Path) -> None:
    stamps = (-0.4, 4294970000.0, 5.0, 5.0, 4.0, 6.0)
    recording = open_recording(carmen(tmp_path / "a.log", "".join(flaser(stamp) for stamp in stamps)))
    repaired = [scan.stamp for scan in recording]
    assert len({f"{stamp:.6f}" for stamp in repaired}) == len(stamps)
    assert repaired == sorted(repaired)
    assert (repaired[2], repaired[5]) == (5.0, 6.0)
    assert 0 <= repaired[0] < repaired[1] < 1


def test_missing_recording_is_not_found(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="no such recording"):
        open_recording(tmp_path / "a.log")


@pytest.mark.parametrize("kind", WRITERS)
def test_bag_is_opened_by_its_suffix_or_as_a_directory(tmp_path: Path, kind: str) -> None:
    recording = open_recording(WRITERS[kind](tmp_path))
    assert (recording.scans, len(list(recording))) == (3, 3)


@pytest.mark.parametrize("name", ["a.csv", "a", "a.log.bz2"])
def test_file_with_another_suffix_is_rejected(tmp_path: Path, name: str) -> None:
    with pytest.raises(InvalidRequest, match="the name must end in"):
        open_recording(carmen(tmp_path / name, flaser(1.0)))


def test_impossible_duration_is_unknown(tmp_path: Path) -> None:
    recording = open_recording(carmen(tmp_path / "a.log", flaser(5.0) + flaser(5.0)))
    assert (recording.scans, recording.duration) == (2, None)
