"""`rce plan`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from rce.cli.lazy.plan import pose
from rce.cli.main import main
from rce.errors import InvalidRequest
from rce.mapping.files.outputs import write_map
from rce.mapping.geometry import Pose
from tests.support.planning import walled


@pytest.fixture
def rce(monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """Run a command line and return its exit status."""

    def run(*words: str) -> int:
        monkeypatch.setattr(sys, "argv", ["rce", *words])
        return main()

    return run


@pytest.fixture
def map_file(tmp_path: Path) -> str:
    write_map(tmp_path / "map", walled())
    return str(tmp_path / "map.yaml")


def test_path_is_planned_and_written(
    rce: Callable[..., int], map_file: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert rce("plan", map_file, "--start", "2,2", "--goal", "8,2,1.5", "--out", str(tmp_path / "out")) == 0
    assert "path.csv, path.png" in capsys.readouterr().out
    assert (tmp_path / "out" / "path.csv").read_text().splitlines()[-1] == "8.0000,2.0000,1.50000,1"


def test_space_is_covered(
    rce: Callable[..., int], map_file: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--start", "2,2", "--cover", "--tool", "1", "--time", "60", "--out", str(tmp_path / "out"))
    assert rce("plan", map_file, *words) == 0
    assert "% of what the robot can reach" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--start", "2,2"], "either --goal or --cover"),
        (["--start", "2,2", "--goal", "8,2", "--cover"], "either --goal or --cover"),
        (["--goal", "8,2"], "give --start"),
        (["--start", "2", "--goal", "8,2"], "--start is '2'"),
        (["--start", "2,2", "--goal", "8,x"], "--goal is '8,x'"),
        (["--start", "2,2", "--goal", "8,inf"], "must be finite"),
        (["--start", "2,2", "--goal", "8,2", "--footprint", "big"], "'big' is not a footprint"),
        (["--start", "2,2", "--goal", "8,2", "--time", "0"], "--time is 0"),
        (["--start", "2,2", "--goal", "8,2", "--tolerance", "-1"], "--tolerance is -1"),
        (["--start", "2,2", "--goal", "5.05,2"], "in an obstacle"),
        (["--start", "2,2", "--goal", "99,2"], "outside of the map"),
        (["--map-job", "x", "--start", "2,2", "--goal", "8,2"], "give one map"),
    ],
)
def test_error_says_what_to_change(
    rce: Callable[..., int],
    map_file: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    reason: str,
) -> None:
    assert rce("plan", map_file, *words, "--out", str(tmp_path / "out")) != 0
    assert reason in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_heading_is_optional() -> None:
    assert pose("1,-2", "--goal") == Pose(1.0, -2.0, 0.0)
    assert pose("1,-2,3", "--goal") == Pose(1.0, -2.0, 3.0)
    with pytest.raises(InvalidRequest):
        pose("1,2,3,4", "--goal")
