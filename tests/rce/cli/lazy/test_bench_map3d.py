from __future__ import annotations

from pathlib import Path

import pytest

from rce.cli.execute import SUCCESS, run
from rce.cli.lazy import bench_map3d
from rce.mapping3d.evaluation.room import sweep
from rce.mapping3d.files.trajectories import trajectory_text
from tests.support.rgbd import CLEAN, simulated, write_tum


@pytest.mark.slow
def test_errors_against_ground_truth_are_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_tum(tmp_path / "desk", list(simulated(0.2, faults=CLEAN)))
    (path / "groundtruth.txt").write_bytes(trajectory_text(sweep(0.2)))
    assert run(["bench", "map3d", str(path), "--camera", "262.5,262.5,159.5,119.5"]) == SUCCESS
    title, row = capsys.readouterr().out.splitlines()
    assert "ATE M" in title
    assert row.split()[:3] == ["desk", "6", "0"]


@pytest.mark.slow
def test_ways_to_offload_are_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench_map3d, "WAYS", ("robot", "key frames"))
    path = write_tum(tmp_path / "desk", list(simulated(0.2, faults=CLEAN)))
    assert run(["bench", "map3d", str(path), "--camera", "262.5,262.5,159.5,119.5", "--offloading"]) == SUCCESS
    title, alone, key_frames = capsys.readouterr().out.splitlines()
    assert "LINE KB/S" in title
    assert alone.split()[:3] == ["desk", "robot", "0"]
    assert key_frames.split()[:3] == ["desk", "key", "frames"]
