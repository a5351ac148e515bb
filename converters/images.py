"""Conversion of `sensor_msgs/Image` to and from PNG and JPEG files.

Stamp, frame and encoding are stored as metadata in a text chunk (PNG) or comment (JPEG) that other programs ignore (see
`image_files`). A file without metadata becomes a message with stamp 0, an empty frame and the encoding of its colour
type. PNG is lossless for the encodings in `ENCODINGS`; yuv422 becomes rgb8. JPEG is lossy and only for 8-bit encodings
with one or three channels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from converters.image_files import Metadata, validate, with_metadata
from converters.scalars import FieldError
from converters.wire import Buffer

PictureFormat: TypeAlias = Literal["png", "jpeg"]
ImageFormat: TypeAlias = PictureFormat | Literal["json"]
Pixels: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class Encoding:
    """Pixel encoding; `to_file` and `from_file` are the OpenCV conversions to and from its channel order, if needed."""

    channels: int
    depth: int  # bytes per channel
    to_file: int | None = None
    from_file: int | None = None


_SWAP3 = (cv2.COLOR_RGB2BGR, cv2.COLOR_BGR2RGB)
_SWAP4 = (cv2.COLOR_RGBA2BGRA, cv2.COLOR_BGRA2RGBA)
# The first encoding with the same channels and depth is used for files without metadata.
ENCODINGS = {
    "mono8": Encoding(1, 1), "8UC1": Encoding(1, 1),
    "mono16": Encoding(1, 2), "16UC1": Encoding(1, 2),
    "rgb8": Encoding(3, 1, *_SWAP3), "bgr8": Encoding(3, 1), "8UC3": Encoding(3, 1),
    "rgb16": Encoding(3, 2, *_SWAP3), "bgr16": Encoding(3, 2),
    "rgba8": Encoding(4, 1, *_SWAP4), "bgra8": Encoding(4, 1), "8UC4": Encoding(4, 1),
    "rgba16": Encoding(4, 2, *_SWAP4), "bgra16": Encoding(4, 2),
}  # fmt: skip
_TO_BGR = {"yuv422": cv2.COLOR_YUV2BGR_UYVY, "uyvy": cv2.COLOR_YUV2BGR_UYVY, "yuv422_yuy2": cv2.COLOR_YUV2BGR_YUY2,
           "yuyv": cv2.COLOR_YUV2BGR_YUY2}  # fmt: skip
_YUV = Encoding(2, 1)


@dataclass(frozen=True, slots=True)
class Picture:
    """Fields of sensor_msgs/Image in order, then those of its header. `data` has `height` rows of `step` bytes."""

    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int
    data: Buffer
    stamp: tuple[int, int] = (0, 0)
    frame_id: str = ""


def read_picture(blob: Buffer) -> Picture:
    """Decode a PNG or JPEG file.

    Raises:
        FieldError: It is neither, or the image is damaged or larger than MAX_PIXEL_BYTES.
    """
    data, metadata = validate(blob)
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise FieldError("the image file is damaged") from error
    if pixels is None or pixels.dtype not in (np.uint8, np.uint16):
        raise FieldError("the image file is damaged")
    height, width = pixels.shape[:2]
    kind = (pixels.shape[2] if pixels.ndim == 3 else 1, pixels.dtype.itemsize)
    names = [name for name, known in ENCODINGS.items() if (known.channels, known.depth) == kind]
    if not names:
        raise FieldError(f"the image has {kind[0]} channels; only gray, colour and colour with alpha are supported")
    name = metadata.encoding if metadata.encoding in names else names[0]
    convert = ENCODINGS[name].from_file
    ready = pixels if convert is None else cv2.cvtColor(pixels, convert)
    rows = np.ascontiguousarray(ready, ready.dtype.newbyteorder("<")).data.cast("B")
    return Picture(height, width, name, 0, len(rows) // height, rows, metadata.stamp, metadata.frame_id)


def write_picture(image: Picture, image_format: PictureFormat) -> bytes:
    """Encode an image as a PNG or JPEG file.

    Raises:
        FieldError: The format cannot hold the encoding or the size, or `data` is shorter than the image.
    """
    pixels = _file_pixels(image)
    if image_format == "jpeg" and (pixels.dtype != np.uint8 or (pixels.ndim == 3 and pixels.shape[2] == 4)):
        raise FieldError(
            f"a JPEG cannot hold the encoding {image.encoding[:40]!r}: use format png or json, or a Forwarder"
        )
    try:  # OpenCV's default settings; others for PNG took two to five times as long and saved hardly any bytes
        written, data = cv2.imencode("." + image_format, pixels)
    except cv2.error:
        written, data = False, np.empty(0, np.uint8)
    if not written:
        raise FieldError(
            f"an image of {image.width} x {image.height} cannot be encoded as {image_format}: use format json"
        )
    return with_metadata(data.tobytes(), Metadata(image.stamp, image.frame_id, image.encoding))


def _file_pixels(image: Picture) -> Pixels:
    """Return the pixels in OpenCV's channel order."""
    if image.encoding in _TO_BGR:
        return cast("Pixels", cv2.cvtColor(pixels_of(image, _YUV), _TO_BGR[image.encoding]))
    encoding = ENCODINGS.get(image.encoding)
    if encoding is None:
        raise FieldError(
            f"an image file cannot hold the encoding {image.encoding[:40]!r}: use format json or a Forwarder; "
            f"supported are {', '.join((*ENCODINGS, *_TO_BGR))}"
        )
    pixels = pixels_of(image, encoding)
    return pixels if encoding.to_file is None else cast("Pixels", cv2.cvtColor(pixels, encoding.to_file))


def pixels_of(image: Picture, encoding: Encoding) -> Pixels:
    """Return the pixels as (height, width) or (height, width, channels), without the padding of the rows."""
    row = image.width * encoding.channels * encoding.depth
    if not row or not image.height or image.step < row or image.step * image.height > len(image.data):
        raise FieldError(
            f"{len(image.data)} bytes in rows of {image.step} do not match an image of {image.width} x {image.height} "
            f"in {image.encoding}"
        )
    if image.width % 2 and encoding is _YUV:
        raise FieldError(f"an image in {image.encoding} must have an even width, not {image.width}")
    lines = np.frombuffer(image.data, np.uint8, image.step * image.height).reshape(image.height, image.step)[:, :row]
    shape = (image.height, image.width, encoding.channels)[: 3 if encoding.channels > 1 else 2]
    if encoding.depth == 1:
        return np.ascontiguousarray(lines).reshape(shape)
    words = np.ascontiguousarray(lines).view(">u2" if image.is_bigendian else "<u2")
    return words.astype(np.uint16, copy=False).reshape(shape)
