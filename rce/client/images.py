"""Images as numpy arrays, to and from the PNG and JPEG blobs of `sensor_msgs/Image` interfaces.

Wants the extra `images` (numpy and Pillow).
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
        f"rce.client.images needs numpy and Pillow: pip install '.[images]' in a checkout of RCE ({error})"
    ) from None

_ARRAYS = {"png": {("uint8", 1), ("uint8", 3), ("uint8", 4), ("uint16", 1)}, "jpeg": {("uint8", 1), ("uint8", 3)}}
_MODES = ("L", "RGB", "RGBA")


def encode(array: NDArray[Any], format: Literal["png", "jpeg"] = "png", quality: int = 90) -> bytes:
    """A PNG or JPEG of an array (height, width) or (height, width, channels).

    uint8 with 1, 3 (RGB order) or, for PNG, 4 (RGBA) channels; for PNG also uint16 with one (depth in millimetres).
    `quality` is for JPEG. Raises InvalidRequest for other arrays.
    """
    plane = array[:, :, 0] if array.ndim == 3 and array.shape[2] == 1 else array
    channels = plane.shape[2] if plane.ndim == 3 else 1
    if plane.ndim not in (2, 3) or (plane.dtype.name, channels) not in _ARRAYS[format] or plane.size == 0:
        raise InvalidRequest(
            f"an array of {array.dtype} and shape {array.shape} is no {format} image: it must be uint8 (height, width) "
            "or (height, width, 3), or for png uint8 (height, width, 4) or uint16 (height, width)"
        )
    out = io.BytesIO()
    # Little compression: for what leaves a robot at once, time counts more than the last tenth of the size.
    Image.fromarray(np.ascontiguousarray(plane)).save(out, format, compress_level=1, quality=quality)
    return out.getvalue()


def decode(blob: bytes) -> NDArray[Any]:
    """The image of a blob: uint8 (height, width), (height, width, 3) in RGB order or (height, width, 4); depth uint16.

    Raises ConversionError.
    """
    try:
        with Image.open(io.BytesIO(blob), formats=("PNG", "JPEG")) as image:
            if image.mode.startswith("I"):
                return np.asarray(image).astype(np.uint16)
            return np.array(image if image.mode in _MODES else image.convert("RGB"))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise ConversionError(f"a blob of {len(blob)} bytes is no PNG or JPEG image: {error}") from None
