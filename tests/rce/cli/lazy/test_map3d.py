from __future__ import annotations

import argparse
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from rce.cli.execute import FAILURE, SUCCESS, run
from rce.cli.lazy import map3d
from rce.cli.lazy.map3d import check_writable, intrinsics
from rce.errors import InvalidRequest
from rce.mapping3d.files.recordings import RgbdRecording
from rce.mapping3d.offload.runs import RunFigures, WrittenMap
from tests.support.rgbd import CLEAN, simulated, write_tum


def test_result_is_described(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    @asynccontextmanager
    async def platform(args: argparse.Namespace) -> AsyncIterator[str]:
        yield "a platform"

    async def mapped(
        access: str, recordings: list[RgbdRecording], directory: Path, progress: Callable[[int], None]
    ) -> tuple[list[WrittenMap], RunFigures]:
        assert access == "a platform"
        progress(6)
        return [WrittenMap(directory, [0]), WrittenMap(directory, [1])], RunFigures(6, 1, 2, 0.12, 3_000_000)

    monkeypatch.setattr(map3d, "platform", platform)
    monkeypatch.setattr(map3d, "map_recordings", mapped)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "cloud.ply").touch()
    recordings = [write_tum(tmp_path / name, list(simulated(0.1, faults=CLEAN))) for name in ("desk", "hall")]
    assert run(["map3d", *map(str, recordings), "--out", str(tmp_path / "out")]) == SUCCESS
    printed = capsys.readouterr().out
    assert "6 frames, 1 without track, 2 key frames of 3.0 MB sent, 20.0 ms" in printed
    assert f"map of desk in {tmp_path / 'out'}: cloud.ply" in printed
    assert "2 maps: no overlap" in printed


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--camera", "1,2,3"], "FX,FY,CX,CY"),
        (["--camera", "0,500,320,240"], "must be positive"),
        (["--depth-scale", "-1"], "--depth-scale must be a positive number"),
        (["--depth-scale", "nan"], "--depth-scale must be a positive number"),
    ],
)
def test_wrong_options_are_named(
    tmp_path: Path, options: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = write_tum(tmp_path / "desk", list(simulated(0.1, faults=CLEAN)))
    assert run(["map3d", str(recording), *options, "--out", str(tmp_path / "out")]) == FAILURE
    assert reason in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_missing_recording_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["map3d", str(tmp_path / "none"), "--out", str(tmp_path / "out")]) == FAILURE
    assert "no such recording" in capsys.readouterr().err


def test_output_that_cannot_be_written_is_refused_at_once(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidRequest, match="is not a directory"):
        check_writable(tmp_path / "file" / "out")


def test_intrinsics_are_four_numbers() -> None:
    assert intrinsics("525,525,319.5,239.5") == (525.0, 525.0, 319.5, 239.5)
