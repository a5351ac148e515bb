"""Decimation: scans, images and clouds with fewer beams, pixels and points, as CDR of the same type."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from converters.images import ENCODINGS, Encoding
from converters.model import IMAGE, Message
from converters.namespaces import Fields, Namespaces
from converters.scalars import FieldError
from converters.wire import Buffer
from rce.errors import ConversionError, InvalidRequest

SCAN, CLOUD = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/PointCloud2"
FIELD = "delivery.decimate"

Size = tuple[int, int]  # width, height in pixels


class Decimator:
    """Function from CDR of a type to smaller CDR of the same type."""

    def __init__(self, message: Message, step: int = 1, size: Size | None = None) -> None:
        """Make a decimator.

        Args:
            message: Type of the messages.
            step: Every how many-th beam, point, or row and column is kept.
            size: Width and height within which an image is scaled, both rounded down to even numbers.

        Raises:
            InvalidRequest: The type cannot be decimated, or not in this way.
        """
        if message.name not in _DECIMATE:
            raise InvalidRequest(
                f"{FIELD}: {message.name} cannot be decimated: {', '.join(sorted(_DECIMATE))} can", field=FIELD
            )
        if size is not None and message.name != IMAGE:
            raise InvalidRequest(f"{FIELD}.size: only {IMAGE} has a size: use step", field=f"{FIELD}.size")
        self._name, self._namespaces = message.name, Namespaces(message)
        self._decimate, self._step, self._size = _DECIMATE[message.name], step, size

    def __call__(self, cdr: Buffer) -> bytes:
        """Return the smaller message.

        Raises:
            ConversionError: The bytes are not CDR of the type, or its parts do not fit each other.
        """
        try:
            fields = self._namespaces.read(cdr)
            self._decimate(fields, self._step, self._size)
            return self._namespaces.write(fields)
        except FieldError as error:
            raise ConversionError(f"{self._name} {error.path}: {error.reason}", field=error.path) from error


def _scan(scan: Fields, step: int, size: Size | None) -> None:
    scan.ranges, scan.intensities = scan.ranges[::step], scan.intensities[::step]
    scan.angle_increment *= step
    scan.time_increment *= step
    scan.angle_max = scan.angle_min + scan.angle_increment * max(len(scan.ranges) - 1, 0)


def _cloud(cloud: Fields, step: int, size: Size | None) -> None:
    """Keep each n-th point, or of a cloud in rows each n-th row and column."""
    if not cloud.height * cloud.width:
        return
    points = rows_of(cloud.data, cloud.height, cloud.width, cloud.point_step, cloud.row_step)
    kept = np.ascontiguousarray(points[:: step if cloud.height > 1 else 1, ::step])
    cloud.height, cloud.width = kept.shape[:2]
    cloud.row_step, cloud.data = cloud.width * cloud.point_step, kept.tobytes()


def _image(image: Fields, step: int, size: Size | None) -> None:
    encoding = ENCODINGS.get(image.encoding) or (Encoding(1, 4) if image.encoding == "32FC1" else None)
    if encoding is None:
        known = ", ".join((*ENCODINGS, "32FC1"))
        raise FieldError(f"images in {image.encoding[:40]!r} cannot be decimated: {known} can", "encoding")
    pixels = rows_of(image.data, image.height, image.width, encoding.channels * encoding.depth, image.step)
    kept = np.ascontiguousarray(pixels[::step, ::step])
    if size is not None:
        kept = _scaled(kept, size, smooth=encoding.depth == 1)
    image.height, image.width = kept.shape[:2]
    image.step, image.data = image.width * kept.shape[2], kept.tobytes()


def _scaled(pixels: NDArray[np.uint8], size: Size, *, smooth: bool) -> NDArray[np.uint8]:
    """Return an image that fits into a size; depth is not averaged, because there is nothing between two surfaces."""
    height, width = pixels.shape[:2]
    factor = min(size[0] / width, size[1] / height, 1.0)
    wanted = max(2, int(width * factor) // 2 * 2), max(2, int(height * factor) // 2 * 2)
    if wanted == (width, height):
        return pixels
    if smooth:
        return cv2.resize(pixels, wanted, interpolation=cv2.INTER_AREA).reshape(wanted[1], wanted[0], -1)  # type: ignore[return-value]
    columns, rows = (np.arange(n) * old // n for n, old in zip(wanted, (width, height), strict=True))
    return np.ascontiguousarray(pixels[rows][:, columns])


def rows_of(data: Buffer, height: int, width: int, unit: int, step: int) -> NDArray[np.uint8]:
    """Return bytes as (height, width, unit), without the padding of the rows.

    Args:
        data: The bytes.
        height: Number of rows.
        width: Number of pixels or points in a row.
        unit: Bytes of a pixel or point.
        step: Bytes of a row with its padding.

    Raises:
        FieldError: There are fewer bytes, or none.
    """
    if not unit or not width or not height or step < width * unit or step * height > len(data):
        raise FieldError(f"{len(data)} bytes in rows of {step} are not {width} x {height} of {unit} bytes", "data")
    lines = np.frombuffer(data, np.uint8, step * height).reshape(height, step)
    return lines[:, : width * unit].reshape(height, width, unit)


_DECIMATE: dict[str, Callable[[Fields, int, Size | None], None]] = {SCAN: _scan, CLOUD: _cloud, IMAGE: _image}
