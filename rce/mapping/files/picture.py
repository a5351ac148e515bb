"""Picture of a map for people: free, occupied and unknown space, the paths of the robots, and a scale bar."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from rce.mapping.grid import OccupancyGrid

Image = NDArray[np.uint8]  # (height, width, 3), blue, green, red

LONG_SIDE = 1600  # pixels of the longer side, approximately
MAX_PIXELS_PER_CELL = 8  # for small maps
FRACTION = 4  # bits of coordinates, for smooth lines
MARGIN, FOOTER = 24, 64  # pixels around the map, and below it for the scale bar
UNKNOWN, FREE, WALL, INK = (222, 217, 212), (255, 255, 255), (48, 36, 28), (70, 62, 56)
START, END = (96, 174, 39), (60, 60, 220)
# Colours that stay apart for most kinds of colour blindness (Okabe and Ito, 2008); blue, green, red.
PATHS = ((178, 114, 0), (0, 94, 213), (115, 158, 0), (167, 121, 204), (233, 180, 86), (0, 159, 230))
FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw(grid: OccupancyGrid, *trajectories: NDArray[np.float64]) -> bytes:
    """Return a PNG of a map with the paths of the robots.

    Args:
        grid: The map.
        trajectories: (n, 4) stamp, x, y, theta, map frame. A single one is drawn from blue at its start, a green dot,
            to red at its end, a red dot; several have one of `PATHS` each, a disc at the start and a ring at the end.
    """
    scale = _scale(grid)
    ground = _ground(grid, scale)
    for number, each in enumerate(trajectories):
        if len(trajectories) == 1:
            _draw_trajectory(ground, grid, each, scale)
        else:
            draw_path(ground, _pixels(ground, grid, each, scale), PATHS[number % len(PATHS)])
    picture: Image = np.array(UNKNOWN, np.uint8) * np.ones(
        (ground.shape[0] + MARGIN + FOOTER, ground.shape[1] + 2 * MARGIN, 1), np.uint8
    )
    picture[MARGIN:-FOOTER, MARGIN:-MARGIN] = ground
    draw_scale_bar(picture, scale / grid.resolution)
    done, png = cv2.imencode(".png", picture)
    if not done:
        raise RuntimeError(f"OpenCV cannot encode an image of shape {picture.shape}")
    return png.tobytes()


def _scale(grid: OccupancyGrid) -> float:
    """Return the pixels per cell; a whole number for small maps, so that cells stay square."""
    scale = LONG_SIDE / max(grid.cells.shape)
    return scale if scale < 1 else float(min(int(scale), MAX_PIXELS_PER_CELL))


def _ground(grid: OccupancyGrid, scale: float) -> Image:
    """Return the map without the path, highest y on top.

    Walls are drawn darker than the average of their cells: thin ones would fade in large maps.
    """
    cells = grid.cells[::-1]
    size = tuple(max(1, round(scale * side)) for side in cells.shape[::-1])
    known = np.where(cells < 0, 0.0, np.clip((65.0 - cells) / 25.0, 0.0, 1.0)).astype(np.float32)
    wall = np.clip((cells - 50.0) / 25.0, 0.0, 1.0).astype(np.float32)
    interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST
    free = cv2.resize(known, size, interpolation=interpolation)[..., None]
    dark = np.clip(cv2.resize(wall, size, interpolation=interpolation) * max(1.0, 1.5 / scale), 0.0, 1.0)[..., None]
    ground = (1 - free) * np.array(UNKNOWN) + free * np.array(FREE)
    return np.ascontiguousarray(np.rint((1 - dark) * ground + dark * np.array(WALL)).astype(np.uint8))


def _draw_trajectory(image: Image, grid: OccupancyGrid, trajectory: NDArray[np.float64], scale: float) -> None:
    """Draw the path of the robot with its ends."""
    if not len(trajectory):
        return
    bits = FRACTION
    points = np.rint(_pixels(image, grid, trajectory, scale) * 2**bits).astype(np.int32)
    shades = cv2.applyColorMap(np.linspace(20, 230, 64).astype(np.uint8)[:, None], cv2.COLORMAP_TURBO)[:, 0].tolist()
    for shade, part in zip(shades, np.array_split(np.arange(len(points)), len(shades)), strict=True):
        if len(part):
            piece = points[part[0] : part[-1] + 2]
            cv2.polylines(image, [piece], False, shade, 2, cv2.LINE_AA, bits)
    for colour, (u, v) in ((START, points[0].tolist()), (END, points[-1].tolist())):
        cv2.circle(image, (u, v), 7 << bits, FREE, cv2.FILLED, cv2.LINE_AA, bits)
        cv2.circle(image, (u, v), 5 << bits, colour, cv2.FILLED, cv2.LINE_AA, bits)


def _pixels(image: Image, grid: OccupancyGrid, trajectory: NDArray[np.float64], scale: float) -> NDArray[np.float64]:
    """Return a trajectory as columns and rows (n, 2) of the map in the picture."""
    x = (trajectory[:, 1] - grid.x) / grid.resolution * scale
    y = image.shape[0] - (trajectory[:, 2] - grid.y) / grid.resolution * scale
    return np.stack([x, y], axis=1)


def draw_path(picture: Image, path: NDArray[np.float64], color: tuple[int, int, int]) -> None:
    """Draw a path (n, 2), columns and rows, with a disc at its start and a ring at its end."""
    if not len(path):
        return
    bits = FRACTION
    pixels = np.rint(path * 2**bits).astype(np.int32)
    cv2.polylines(picture, [pixels], False, (255, 255, 255), 5, cv2.LINE_AA, bits)
    cv2.polylines(picture, [pixels], False, color, 3, cv2.LINE_AA, bits)
    start, end = pixels[0].tolist(), pixels[-1].tolist()
    cv2.circle(picture, start, 7 << bits, color, cv2.FILLED, cv2.LINE_AA, bits)
    cv2.circle(picture, start, 7 << bits, INK, 1, cv2.LINE_AA, bits)
    cv2.circle(picture, end, 7 << bits, color, 3, cv2.LINE_AA, bits)


def draw_scale_bar(image: Image, pixels_per_metre: float) -> None:
    """Draw a bar of 1, 2 or 5 times a power of ten metres, about a fifth of the width."""
    wanted = 0.2 * image.shape[1] / pixels_per_metre
    power = 10.0 ** math.floor(math.log10(wanted))
    metres = max(step * power for step in (1, 2, 5) if step * power <= wanted)
    left, base = MARGIN, image.shape[0] - 22
    right = left + round(metres * pixels_per_metre)
    for start, end in (
        ((left, base), (right, base)),
        ((left, base - 7), (left, base)),
        ((right, base - 7), (right, base)),
    ):
        cv2.line(image, start, end, INK, 2, cv2.LINE_AA)
    cv2.putText(image, f"{metres:g} m", (right + 10, base + 4), FONT, 0.6, INK, 1, cv2.LINE_AA)
