"""Reader of maps in the format of map_server: an image (PGM, or any that OpenCV reads) and its YAML file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from rce.errors import InvalidRequest, NotFound
from rce.mapping.files.outputs import FREE, OCCUPIED
from rce.mapping.grid import UNKNOWN, OccupancyGrid

MODES = ("trinary", "scale", "raw")
MAX_CELLS = 200_000_000  # a square of 700 m at 5 cm
MAX_YAML = 100_000  # bytes


def read_map(path: Path) -> OccupancyGrid:
    """Return the map that a YAML file of map_server describes.

    Raises:
        NotFound: The file or its image is missing.
        InvalidRequest: They are not a map, or the map is rotated.
    """
    metadata = _read_yaml(path)
    image, resolution, x, y = _image_path(path, metadata), *_origin(path, metadata)
    pixels = _read_image(image)
    mode = metadata.get("mode", "trinary")
    if mode not in MODES:
        raise InvalidRequest(f"{path}: unknown mode {mode!r}; it must be one of {', '.join(MODES)}", field="mode")
    occupied, free = (
        _number(path, metadata, key, low) for key, low in (("occupied_thresh", OCCUPIED), ("free_thresh", FREE))
    )
    cells = pixels if mode == "raw" else _shades(pixels, bool(metadata.get("negate", 0)), mode, occupied, free)
    known = np.where(cells > 100, UNKNOWN, cells.astype(np.int16)).astype(np.int8)
    return OccupancyGrid(np.ascontiguousarray(known[::-1]), resolution, x, y)


def _shades(pixels: NDArray[np.uint8], negate: bool, mode: str, occupied: float, free: float) -> NDArray[np.int16]:
    """Return percent (0..100) or UNKNOWN for the shade of each pixel."""
    dark = (pixels if negate else 255 - pixels.astype(np.int16)) / 255.0
    between = np.full(dark.shape, UNKNOWN, np.int16)
    if mode == "scale":
        between = np.rint(1 + 98 * (dark - free) / max(occupied - free, 1e-9)).astype(np.int16)
    shades: NDArray[np.int16] = np.where(dark > occupied, 100, np.where(dark < free, 0, between)).astype(np.int16)
    return shades


def _read_yaml(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise NotFound(f"no such map: {path}", field="map")
    if path.stat().st_size > MAX_YAML:
        raise InvalidRequest(f"{path} is too large to be the YAML file of a map", field="map")
    try:
        metadata = yaml.safe_load(path.read_text())
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InvalidRequest(f"{path} is not YAML: {error}", field="map") from None
    if not isinstance(metadata, dict) or not isinstance(metadata.get("image"), str):
        raise InvalidRequest(f"{path} is not the YAML file of a map: the key image is missing", field="image")
    return metadata


def _image_path(path: Path, metadata: dict[str, Any]) -> Path:
    image = path.parent / str(metadata["image"])
    if not image.is_file():
        raise NotFound(f"the image {image} of the map {path} does not exist", field="image")
    return image


def _origin(path: Path, metadata: dict[str, Any]) -> tuple[float, float, float]:
    """Return the resolution, and x and y of the lower left corner, metres."""
    resolution = _number(path, metadata, "resolution")
    if not 0.001 <= resolution <= 10.0:
        raise InvalidRequest(f"{path}: the resolution is {resolution} m; it must be 1 mm to 10 m", field="resolution")
    origin: Any = metadata.get("origin")
    try:
        x, y, yaw = (float(value) for value in origin)
    except (TypeError, ValueError):
        raise InvalidRequest(f"{path}: the origin is {origin!r}; it must be three numbers", field="origin") from None
    if not math.isfinite(x + y) or yaw != 0.0:
        raise InvalidRequest(
            f"{path}: the origin {origin} is rotated or not finite; only maps without rotation are supported",
            field="origin",
        )
    return resolution, x, y


def _number(path: Path, metadata: dict[str, Any], key: str, default: float = math.nan) -> float:
    value = metadata.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InvalidRequest(f"{path}: {key} is {value!r}; it must be a number", field=key)
    return float(value)


def _read_image(path: Path) -> NDArray[np.uint8]:
    pixels = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if pixels is None:
        raise InvalidRequest(f"{path} is damaged or not an image", field="image")
    if pixels.size > MAX_CELLS:
        raise InvalidRequest(f"{path} has {pixels.size:,} cells; the limit is {MAX_CELLS:,}", field="image")
    return np.asarray(pixels, np.uint8)
