"""Reading maps in the format of map_server: a picture (PGM, or any that OpenCV reads) and a YAML file beside it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from rce.errors import InvalidRequest, NotFound
from rce.mapping.grid import UNKNOWN, OccupancyGrid
from rce.mapping.outputs import FREE, OCCUPIED

MODES = ("trinary", "scale", "raw")
MOST_CELLS = 200_000_000  # a square of 700 m at 5 cm
LARGEST_YAML = 100_000  # bytes


def read_map(path: Path) -> OccupancyGrid:
    """The map that a YAML file of map_server describes.

    NotFound if the file or its picture is missing, InvalidRequest if they are not a map, or one that is turned.
    """
    about = _read_yaml(path)
    image, resolution, x, y = _picture_path(path, about), *_place(path, about)
    pixels = _read_picture(image)
    mode = about.get("mode", "trinary")
    if mode not in MODES:
        raise InvalidRequest(f"{path}: the mode {mode!r} is none of {', '.join(MODES)}", field="mode")
    occupied, free = (
        _number(path, about, key, low) for key, low in (("occupied_thresh", OCCUPIED), ("free_thresh", FREE))
    )
    cells = pixels if mode == "raw" else _shades(pixels, bool(about.get("negate", 0)), mode, occupied, free)
    known = np.where(cells > 100, UNKNOWN, cells.astype(np.int16)).astype(np.int8)
    return OccupancyGrid(np.ascontiguousarray(known[::-1]), resolution, x, y)


def _shades(pixels: NDArray[np.uint8], negate: bool, mode: str, occupied: float, free: float) -> NDArray[np.int16]:
    """Percent (0..100) by the shade of the pixels, and UNKNOWN."""
    dark = (pixels if negate else 255 - pixels.astype(np.int16)) / 255.0
    between = np.full(dark.shape, UNKNOWN, np.int16)
    if mode == "scale":
        between = np.rint(1 + 98 * (dark - free) / max(occupied - free, 1e-9)).astype(np.int16)
    shades: NDArray[np.int16] = np.where(dark > occupied, 100, np.where(dark < free, 0, between)).astype(np.int16)
    return shades


def _read_yaml(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise NotFound(f"no such map: {path}", field="map")
    if path.stat().st_size > LARGEST_YAML:
        raise InvalidRequest(f"{path} is too large to be the YAML file of a map", field="map")
    try:
        about = yaml.safe_load(path.read_text())
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InvalidRequest(f"{path} is not YAML: {error}", field="map") from None
    if not isinstance(about, dict) or not isinstance(about.get("image"), str):
        raise InvalidRequest(f"{path} is not the YAML file of a map: it names no image", field="image")
    return about


def _picture_path(path: Path, about: dict[str, Any]) -> Path:
    image = path.parent / str(about["image"])
    if not image.is_file():
        raise NotFound(f"{path} names the picture {image}, which is not there", field="image")
    return image


def _place(path: Path, about: dict[str, Any]) -> tuple[float, float, float]:
    """Resolution, and x and y of the lower left corner, metres."""
    resolution = _number(path, about, "resolution")
    if not 0.001 <= resolution <= 10.0:
        raise InvalidRequest(f"{path}: a resolution of {resolution} m is not between 1 mm and 10 m", field="resolution")
    origin = about.get("origin")
    try:
        x, y, yaw = (float(value) for value in origin)  # type: ignore[union-attr]
    except (TypeError, ValueError):
        raise InvalidRequest(f"{path}: the origin is {origin!r}, not three numbers", field="origin") from None
    if not math.isfinite(x + y) or yaw != 0.0:
        raise InvalidRequest(
            f"{path}: the origin {origin} is turned or not finite; only upright maps are read", field="origin"
        )
    return resolution, x, y


def _number(path: Path, about: dict[str, Any], key: str, default: float = math.nan) -> float:
    value = about.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InvalidRequest(f"{path}: {key} is {value!r}, not a number", field=key)
    return float(value)


def _read_picture(path: Path) -> NDArray[np.uint8]:
    pixels = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if pixels is None:
        raise InvalidRequest(f"{path} is damaged, or no picture", field="image")
    if pixels.size > MOST_CELLS:
        raise InvalidRequest(f"{path} has {pixels.size:,} cells; at most {MOST_CELLS:,} are read", field="image")
    return np.asarray(pixels, np.uint8)
