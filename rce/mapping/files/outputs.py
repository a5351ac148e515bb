"""Writer of the files of a finished map. Each file is written atomically."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rce.errors import InvalidRequest
from rce.mapping.files.picture import draw
from rce.mapping.grid import OccupancyGrid

# Thresholds of the probability in map_server. Its grey 205 means p = 0.19608, which is above 0.196: unknown stays
# unknown.
OCCUPIED, FREE = 0.65, 0.196
BLACK, GREY, WHITE = 0, 205, 254

Trajectory = NDArray[np.float64]


def write_outputs(directory: Path, grid: OccupancyGrid, trajectory: Trajectory, *others: Trajectory) -> list[Path]:
    """Write map.pgm, map.yaml, map.png and trajectory.txt; return their paths.

    Args:
        directory: Directory, created if it does not exist.
        grid: The map.
        trajectory: (n, 4) stamp, x, y, theta of each scan, map frame.
        others: The same of other robots on the map, for the picture.
    """
    paths = write_pictures(directory, "map", grid, trajectory, *others)
    write_atomically(directory / "trajectory.txt", trajectory_text(trajectory))
    return [*paths, directory / "trajectory.txt"]


def write_joint_outputs(
    directory: Path, place: int, grid: OccupancyGrid, trajectories: Mapping[int, Trajectory]
) -> None:
    """Write map.pgm, map.yaml and map.png of a map of several recordings, and trajectory_N.txt of each recording.

    Args:
        directory: Directory, created if it does not exist.
        place: Number of the map, from 1; the names of the second one begin with map_2.
        grid: The map.
        trajectories: (n, 4) stamp, x, y, theta of each scan of each recording, by number of the recording from 0.
    """
    write_pictures(directory, "map" if place == 1 else f"map_{place}", grid, *trajectories.values())
    for number, trajectory in trajectories.items():
        write_atomically(directory / f"trajectory_{number + 1}.txt", trajectory_text(trajectory))


def write_pictures(directory: Path, stem: str, grid: OccupancyGrid, *trajectories: Trajectory) -> list[Path]:
    """Write STEM.pgm, STEM.yaml and STEM.png with these trajectories; return their paths."""
    directory.mkdir(parents=True, exist_ok=True)
    contents = {
        f"{stem}.pgm": pgm(grid),
        f"{stem}.yaml": map_yaml(grid, f"{stem}.pgm"),
        f"{stem}.png": draw(grid, *trajectories),
    }
    for name, content in contents.items():
        write_atomically(directory / name, content)
    return [directory / name for name in contents]


def write_map(path: Path, grid: OccupancyGrid, occupied: float | None = None, free: float | None = None) -> None:
    """Write a map as `path`.pgm and `path`.yaml in the format of map_server.

    Args:
        path: Path without extension; .pgm, .yaml and .yml are removed.
        grid: The map.
        occupied: Probability from which on a cell is occupied; None for that of map_server.
        free: Probability below which a cell is free; None for that of map_server.

    Raises:
        InvalidRequest: The thresholds are not in order.
        OSError: The files cannot be written.
    """
    high, low = OCCUPIED if occupied is None else occupied, FREE if free is None else free
    if not 0 < low < high < 1:
        raise InvalidRequest(f"the thresholds must be 0 < free < occupied < 1; free is {low:g}, occupied {high:g}")
    path = path.with_suffix("") if path.suffix in (".pgm", ".yaml", ".yml") else path
    path.parent.mkdir(parents=True, exist_ok=True)
    image = path.with_name(f"{path.name}.pgm")
    write_atomically(image, pgm(grid, high, low))
    write_atomically(path.with_name(f"{path.name}.yaml"), map_yaml(grid, image.name, high, low))


def pgm(grid: OccupancyGrid, occupied: float = OCCUPIED, free: float = FREE) -> bytes:
    """Return the image of a map in trinary mode: highest y first, black occupied, white free, grey unknown."""
    pixels = np.full_like(grid.cells, GREY, dtype=np.uint8)
    pixels[grid.cells >= 100 * occupied] = BLACK
    pixels[(grid.cells >= 0) & (grid.cells < 100 * free)] = WHITE
    header = f"P5\n# {grid.resolution:.6g} m/cell\n{pixels.shape[1]} {pixels.shape[0]}\n255\n"
    return header.encode() + pixels[::-1].tobytes()


def map_yaml(grid: OccupancyGrid, image: str, occupied: float = OCCUPIED, free: float = FREE) -> bytes:
    """Return the YAML file of a map whose image has this name."""
    return (
        f"image: {image}\n"
        "mode: trinary\n"
        f"resolution: {grid.resolution:.9g}\n"
        f"origin: [{grid.x:.9g}, {grid.y:.9g}, 0.0]\n"
        "negate: 0\n"
        f"occupied_thresh: {occupied:.6g}\n"
        f"free_thresh: {free:.6g}\n"
    ).encode()


def trajectory_text(trajectory: NDArray[np.float64]) -> bytes:
    """Return lines `timestamp x y theta`: seconds, metres, radians."""
    return "".join(f"{t:.6f} {x:.6f} {y:.6f} {theta:.6f}\n" for t, x, y, theta in trajectory.tolist()).encode()


def write_atomically(path: Path, content: bytes) -> None:
    """Replace a file by one with this content. A reader sees the old or the new content, never a part."""
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        Path(temporary).chmod(0o644)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
