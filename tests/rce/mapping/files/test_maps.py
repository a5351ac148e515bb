from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rce.errors import InvalidRequest, NotFound
from rce.mapping.files.maps import read_map
from rce.mapping.files.outputs import map_yaml, pgm
from rce.mapping.grid import OccupancyGrid

CELLS = np.array([[-1, 0, 100], [100, 0, -1]], np.int8)
GRID = OccupancyGrid(CELLS, 0.05, -1.0, 2.5)


def written(directory: Path, metadata: str = "", image: bytes = b"") -> Path:
    (directory / "map.pgm").write_bytes(image or pgm(GRID))
    path = directory / "map.yaml"
    path.write_text(metadata or map_yaml(GRID, "map.pgm").decode())
    return path


def test_written_map_is_read_back(tmp_path: Path) -> None:
    grid = read_map(written(tmp_path))
    np.testing.assert_array_equal(grid.cells, CELLS)
    assert (grid.resolution, grid.x, grid.y) == (0.05, -1.0, 2.5)


SHADES = b"P5\n4 1\n255\n" + bytes([0, 100, 205, 254])
METADATA = "image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0]\n"


@pytest.mark.parametrize(
    ("extra", "cells"),
    [
        ("", [100, -1, -1, 0]),
        ("negate: 1\nmode: trinary\n", [0, -1, 100, 100]),
        ("mode: scale\noccupied_thresh: 0.9\nfree_thresh: 0.1\n", [100, 63, 13, 0]),
        ("mode: raw\n", [0, 100, -1, -1]),
    ],
)
def test_image_is_interpreted_by_mode(tmp_path: Path, extra: str, cells: list[int]) -> None:
    grid = read_map(written(tmp_path, METADATA + extra, SHADES))
    assert grid.cells.tolist() == [cells]


@pytest.mark.parametrize(
    ("metadata", "reason"),
    [
        ("a: [", "not YAML"),
        ("3\n", "key image is missing"),
        ("image: map.pgm\n", "resolution"),
        ("image: map.pgm\nresolution: 0\norigin: [0, 0, 0]\n", "resolution"),
        ("image: map.pgm\nresolution: 0.1\norigin: [0, 0]\n", "origin"),
        ("image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0.5]\n", "rotated"),
        (METADATA + "mode: grey\n", "mode"),
        (METADATA + "free_thresh: low\n", "free_thresh"),
    ],
)
def test_invalid_metadata_is_rejected(tmp_path: Path, metadata: str, reason: str) -> None:
    with pytest.raises(InvalidRequest, match=reason):
        read_map(written(tmp_path, metadata))


def test_invalid_image_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="not an image"):
        read_map(written(tmp_path, image=b"P5\nabc"))


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="no such map"):
        read_map(tmp_path / "map.yaml")
    written(tmp_path, "image: other.pgm\nresolution: 0.1\norigin: [0, 0, 0]\n")
    with pytest.raises(NotFound, match=r"other\.pgm"):
        read_map(tmp_path / "map.yaml")
