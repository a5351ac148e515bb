"""Files of a plan: the path as CSV, and a picture of it on the map."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from rce.mapping.files.outputs import write_atomically
from rce.mapping.files.picture import END, LONG_SIDE, START, UNKNOWN, WALL
from rce.mapping.grid import OccupancyGrid
from rce.planning.costmap import BLOCKED, BORDER, OCCUPIED, Costmap

MAX_PIXELS_PER_CELL = 8
FORWARD, REVERSE, COSTLY = (200, 90, 20), (40, 40, 220), (150, 150, 255)  # blue, green, red
SHADE = 0.35  # share of the costs in a pixel


def write_plan(directory: Path, grid: OccupancyGrid, costmap: Costmap, poses: NDArray[np.float64]) -> list[Path]:
    """Write `path.csv` and `path.png` to a directory, which is made if needed; return the files.

    Args:
        directory: The directory.
        grid: The map.
        costmap: Its costs.
        poses: (n, 4) x, y, theta, and 1 forward or -1 in reverse.
    """
    directory.mkdir(parents=True, exist_ok=True)
    contents = {"path.csv": path_csv(poses), "path.png": draw(grid, costmap, poses)}
    for name, content in contents.items():
        write_atomically(directory / name, content)
    return [directory / name for name in contents]


def path_csv(poses: NDArray[np.float64]) -> bytes:
    """Return a header `x,y,theta,direction` and a line for each pose (n, 4): metres, radians, 1 or -1 in reverse."""
    lines = [f"{x:.4f},{y:.4f},{theta:.5f},{direction:.0f}" for x, y, theta, direction in poses.tolist()]
    return "\n".join(["x,y,theta,direction", *lines, ""]).encode()


def draw(grid: OccupancyGrid, costmap: Costmap, poses: NDArray[np.float64]) -> bytes:
    """Return a PNG of a map with its costs and a path: blue forward, red in reverse, from a green to a red dot."""
    height, width = grid.cells.shape
    scale = min(LONG_SIDE / max(height, width), MAX_PIXELS_PER_CELL)
    size = max(1, round(scale * width)), max(1, round(scale * height))
    image = cv2.resize(_ground(grid, costmap), size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST)
    places = (poses[:, :2] - (grid.x, grid.y)) / grid.resolution * scale
    pixels = np.rint(np.stack([places[:, 0], size[1] - places[:, 1]], axis=1)).astype(np.int32)
    for begin, end, direction in zip(pixels[:-1].tolist(), pixels[1:].tolist(), poses[1:, 3].tolist(), strict=True):
        cv2.line(image, begin, end, FORWARD if direction > 0 else REVERSE, 2, cv2.LINE_AA)
    for place, color in ((pixels[0], START), (pixels[-1], END)):
        cv2.circle(image, place.tolist(), 6, color, -1, cv2.LINE_AA)
    done, png = cv2.imencode(".png", image)
    if not done:
        raise RuntimeError(f"OpenCV cannot encode an image of shape {image.shape}")
    return png.tobytes()


def _ground(grid: OccupancyGrid, costmap: Costmap) -> NDArray[np.uint8]:
    """Return the map, highest y on top: walls black, unknown space grey, cells pale red as far as they cost."""
    costs = costmap.inscribed_costs[BORDER:-BORDER, BORDER:-BORDER, None].astype(np.float64)
    share = SHADE * np.minimum(costs, BLOCKED) / BLOCKED
    free = (1 - share) * 255 + share * np.array(COSTLY)
    image = np.where(grid.cells[..., None] < 0, np.array(UNKNOWN), free).astype(np.uint8)
    image[grid.cells >= OCCUPIED] = WALL
    return np.ascontiguousarray(image[::-1])
