"""Conversion between numpy arrays and the PNG or JPEG blobs of `sensor_msgs/Image` interfaces.

Needs the extra `images` (numpy and Pillow).
"""

from __future__ import annotations

import io
from typing import Any, Literal

from rce.errors import ConversionError, InvalidRequest

try:
    import numpy as np
    from numpy.typing import NDArray
    from PIL import Image
except ImportError as error:
    raise ImportError(
        f"rce.client.images needs numpy and Pillow: run pip install -e '.[images]' in a checkout of RCE ({error})"
    ) from None

_ARRAYS = {"png": {("uint8", 1), ("uint8", 3), ("uint8", 4), ("uint16", 1)}, "jpeg": {("uint8", 1), ("uint8", 3)}}
_MODES = ("L", "RGB", "RGBA")


def encode(array: NDArray[Any], format: Literal["png", "jpeg"] = "png", quality: int = 90) -> bytes:
    """Encode an array as a PNG or JPEG file.

    Args:
        array: Image of shape (height, width) or (height, width, channels). uint8 with 1, 3 (RGB) or, for PNG only, 4
            (RGBA) channels; for PNG also uint16 with one channel (depth in millimetres).
        format: File format.
        quality: JPEG quality, 1 to 95; ignored for PNG.

    Raises:
        InvalidRequest: The format cannot hold this type or shape.
    """
    plane = array[:, :, 0] if array.ndim == 3 and array.shape[2] == 1 else array
    channels = plane.shape[2] if plane.ndim == 3 else 1
    if plane.ndim not in (2, 3) or (plane.dtype.name, channels) not in _ARRAYS[format] or plane.size == 0:
        raise InvalidRequest(
            f"cannot encode an array of {array.dtype} and shape {array.shape} as {format}: it must be uint8 of shape "
            "(height, width) or (height, width, 3), or for png uint8 (height, width, 4) or uint16 (height, width)"
        )
    out = io.BytesIO()
    # Low compression: images leave the robot at once, and encoding time matters more than the last tenth of the size.
    Image.fromarray(np.ascontiguousarray(plane)).save(out, format, compress_level=1, quality=quality)
    return out.getvalue()


def decode(blob: bytes) -> NDArray[Any]:
    """Decode a PNG or JPEG file.

    Returns:
        uint8 array of shape (height, width), (height, width, 3) in RGB order or (height, width, 4) in RGBA order, or
        uint16 of shape (height, width) for 16-bit depth images.

    Raises:
        ConversionError: The bytes are not a readable PNG or JPEG file.
    """
    try:
        with Image.open(io.BytesIO(blob), formats=("PNG", "JPEG")) as image:
            if image.mode.startswith("I"):
                return np.asarray(image).astype(np.uint16)
            return np.array(image if image.mode in _MODES else image.convert("RGB"))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise ConversionError(f"a blob of {len(blob)} bytes is not a PNG or JPEG image: {error}") from None
