from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from rce.mapping.files.outputs import trajectory_text, write_atomically, write_outputs
from rce.mapping.grid import OccupancyGrid

GRID = OccupancyGrid(np.array([[0, 10, -1], [100, 66, 40]], np.int8), 0.05, -1.25, 0.3)
TRAJECTORY = np.array([[1134864629.895182, -1.2, 0.35, 3.0], [1134864630.1, -1.15, 0.36, -3.0]])


def image(path: Path, how: int) -> NDArray[np.uint8]:
    pixels = cv2.imread(str(path), how)
    assert pixels is not None
    return pixels.astype(np.uint8)


def load(directory: Path) -> NDArray[np.int8]:
    """Load a map as map_server does in trinary mode: 0 free, 100 occupied, -1 unknown; lowest y first."""
    meta = yaml.safe_load((directory / "map.yaml").read_text())
    assert meta["mode"] == "trinary"
    pixels = image(directory / meta["image"], cv2.IMREAD_GRAYSCALE)
    occupancy = (255 - pixels[::-1].astype(float)) / 255
    cells = np.full(occupancy.shape, -1, np.int8)
    cells[occupancy > meta["occupied_thresh"]] = 100
    cells[occupancy < meta["free_thresh"]] = 0
    return cells


def test_written_map_is_loaded_by_map_server_rules(tmp_path: Path) -> None:
    write_outputs(tmp_path, GRID, TRAJECTORY)
    assert load(tmp_path).tolist() == [[0, 0, -1], [100, 100, -1]]
    meta = yaml.safe_load((tmp_path / "map.yaml").read_text())
    assert (meta["resolution"], meta["origin"], meta["negate"]) == (0.05, [-1.25, 0.3, 0.0], 0)


def test_trajectory_has_a_line_for_each_scan_with_microseconds() -> None:
    lines = trajectory_text(TRAJECTORY).decode().splitlines()
    assert lines == [
        "1134864629.895182 -1.200000 0.350000 3.000000",
        "1134864630.100000 -1.150000 0.360000 -3.000000",
    ]


def test_exactly_the_documented_files_are_written(tmp_path: Path) -> None:
    paths = write_outputs(tmp_path / "new" / "out", GRID, TRAJECTORY)
    assert sorted(path.name for path in paths) == ["map.pgm", "map.png", "map.yaml", "trajectory.txt"]
    assert sorted((tmp_path / "new" / "out").iterdir()) == sorted(paths)


def test_map_without_trajectory_is_drawn(tmp_path: Path) -> None:
    write_outputs(tmp_path, GRID, np.empty((0, 4)))
    assert (tmp_path / "trajectory.txt").read_bytes() == b""


def test_failed_write_keeps_the_old_file_and_no_temporary_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "map.pgm"
    write_atomically(path, b"old")

    def fail(self: Path, target: Path) -> Path:
        raise OSError("disk full")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        write_atomically(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
