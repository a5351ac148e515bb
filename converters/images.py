"""`sensor_msgs/Image` as PNG or JPEG.

The stamp, the frame and the encoding, which a picture file has no place for, travel in a text chunk (PNG) or a
comment (JPEG) that other programs ignore (`image_files`). A plain picture becomes a message with stamp 0, an empty
frame and the encoding of its colour type. PNG keeps every pixel of the encodings in `ENCODINGS`; yuv422 becomes rgb8.
JPEG is lossy and holds mono8, rgb8 and their kin only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from converters.fitting import Misfit
from converters.image_files import Note, checked, with_note
from converters.wire import Buffer

PictureFormat: TypeAlias = Literal["png", "jpeg"]
ImageFormat: TypeAlias = PictureFormat | Literal["json"]
Pixels: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class Encoding:
    """`to_file` and `from_file` are the OpenCV conversions to and from its order of channels, None for none."""

    channels: int
    depth: int  # bytes a channel
    to_file: int | None = None
    from_file: int | None = None


_SWAP3 = (cv2.COLOR_RGB2BGR, cv2.COLOR_BGR2RGB)
_SWAP4 = (cv2.COLOR_RGBA2BGRA, cv2.COLOR_BGRA2RGBA)
# The first of a kind (channels, depth) is what a picture without our note becomes.
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
    """The fields of sensor_msgs/Image in their order, then those of its header. `data` has `height` rows of `step`."""

    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int
    data: Buffer
    stamp: tuple[int, int] = (0, 0)
    frame_id: str = ""


def read_picture(blob: Buffer) -> Picture:
    """The image in a PNG or JPEG file; Misfit if it is neither, damaged or larger than MAX_PIXEL_BYTES."""
    data, note = checked(blob)
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise Misfit("the picture is damaged") from error
    if pixels is None or pixels.dtype not in (np.uint8, np.uint16):
        raise Misfit("the picture is damaged")
    height, width = pixels.shape[:2]
    kind = (pixels.shape[2] if pixels.ndim == 3 else 1, pixels.dtype.itemsize)
    names = [name for name, known in ENCODINGS.items() if (known.channels, known.depth) == kind]
    if not names:
        raise Misfit(f"the picture has {kind[0]} channels; gray, colour and colour with alpha are known")
    name = note.encoding if note.encoding in names else names[0]
    convert = ENCODINGS[name].from_file
    ready = pixels if convert is None else cv2.cvtColor(pixels, convert)
    rows = np.ascontiguousarray(ready, ready.dtype.newbyteorder("<")).data.cast("B")
    return Picture(height, width, name, 0, len(rows) // height, rows, note.stamp, note.frame_id)


def write_picture(image: Picture, image_format: PictureFormat) -> bytes:
    """A PNG or JPEG file; Misfit if it cannot hold the encoding or the size, or `data` is shorter than the image."""
    pixels = _file_pixels(image)
    if image_format == "jpeg" and (pixels.dtype != np.uint8 or (pixels.ndim == 3 and pixels.shape[2] == 4)):
        raise Misfit(f"a JPEG cannot hold the encoding {image.encoding[:40]!r}: use format png or json, or a Forwarder")
    try:  # OpenCV's own settings: any other for PNG took two to five times as long for files of nearly the same size
        written, data = cv2.imencode("." + image_format, pixels)
    except cv2.error:
        written, data = False, np.empty(0, np.uint8)
    if not written:
        raise Misfit(f"an image of {image.width} x {image.height} cannot become a {image_format}: use format json")
    return with_note(data.tobytes(), Note(image.stamp, image.frame_id, image.encoding))


def _file_pixels(image: Picture) -> Pixels:
    """The pixels in OpenCV's order of channels."""
    if image.encoding in _TO_BGR:
        return cast("Pixels", cv2.cvtColor(_rows(image, _YUV), _TO_BGR[image.encoding]))
    encoding = ENCODINGS.get(image.encoding)
    if encoding is None:
        raise Misfit(
            f"a picture cannot hold the encoding {image.encoding[:40]!r}: use format json or a Forwarder; "
            f"pictures hold {', '.join((*ENCODINGS, *_TO_BGR))}"
        )
    pixels = _rows(image, encoding)
    return pixels if encoding.to_file is None else cast("Pixels", cv2.cvtColor(pixels, encoding.to_file))


def _rows(image: Picture, encoding: Encoding) -> Pixels:
    """(height, width) or (height, width, channels), without the padding at the ends of rows."""
    row = image.width * encoding.channels * encoding.depth
    if not row or not image.height or image.step < row or image.step * image.height > len(image.data):
        raise Misfit(
            f"{len(image.data)} bytes in rows of {image.step} are no image of {image.width} x {image.height} "
            f"in {image.encoding}"
        )
    if image.width % 2 and encoding is _YUV:
        raise Misfit(f"an image in {image.encoding} has an even width, not {image.width}")
    lines = np.frombuffer(image.data, np.uint8, image.step * image.height).reshape(image.height, image.step)[:, :row]
    shape = (image.height, image.width, encoding.channels)[: 3 if encoding.channels > 1 else 2]
    if encoding.depth == 1:
        return np.ascontiguousarray(lines).reshape(shape)
    words = np.ascontiguousarray(lines).view(">u2" if image.is_bigendian else "<u2")
    return words.astype(np.uint16, copy=False).reshape(shape)
