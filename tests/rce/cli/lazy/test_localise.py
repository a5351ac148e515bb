"""`rce localise`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rce.cli.main import main
from rce.mapping.files.outputs import write_map
from rce.mapping.grid import OccupancyGrid
from tests.support.recordings import carmen


@pytest.fixture
def rce(monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """Run a command line and return its exit status."""

    def run(*words: str) -> int:
        monkeypatch.setattr(sys, "argv", ["rce", *words])
        return main()

    return run


def write_room(path: Path) -> str:
    """Write the map of a room of 8 x 4 m with the origin at its centre."""
    cells = np.zeros((80, 160), np.int8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 100, 100, 100, 100
    write_map(path, OccupancyGrid(cells, 0.05, -4.0, -2.0))
    return f"{path}.yaml"


def write_standing_robot(path: Path, scans: int) -> str:
    """Write a log of a robot that stands in the middle of the room, with 180 beams from the right to the left."""
    angles = np.radians(np.arange(180) - 90.0)
    with np.errstate(divide="ignore"):
        ranges = np.minimum(3.9 / np.abs(np.cos(angles)), 1.9 / np.abs(np.sin(angles)))
    words = " ".join(f"{value:.2f}" for value in ranges)
    lines = (f"FLASER 180 {words} 0 0 0 0 0 0 {i / 10:.6f} host {i / 10:.6f}\n" for i in range(scans))
    return str(carmen(path, "".join(lines)))


def test_trajectory_in_the_map_is_written(
    rce: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    room, log, out = write_room(tmp_path / "room"), write_standing_robot(tmp_path / "stand.clf", 5), tmp_path / "out"
    assert rce("localise", room, log, "--start", "0.3,0.2", "--out", str(out)) == 0
    assert "5 of 5 scans localised, from scan 1 on; in" in capsys.readouterr().out
    rows = np.loadtxt(out / "trajectory.txt")
    assert np.abs(rows[:, 1:]).max() < 0.1
    assert (out / "map.png").read_bytes().startswith(b"\x89PNG")


def test_robot_that_is_nowhere_in_the_map_is_an_error(
    rce: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The room looks the same turned by half a turn: no place is better than all others."""
    room, log = write_room(tmp_path / "room"), write_standing_robot(tmp_path / "stand.clf", 3)
    assert rce("localise", room, log, "--out", str(tmp_path / "out")) == 1
    assert "found nowhere" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
