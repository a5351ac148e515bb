"""Encoders and decoders of images as NumPy arrays, by the name of a codec."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from rce.codecs.names import COLOR
from rce.codecs.packed import Header, PackedImage
from rce.errors import ConversionError, InvalidRequest
from rce.video import color, depth
from rce.video.packet import Packet

Array = NDArray[Any]
ASIS, SWAPPED = (0, 1, 2), (2, 1, 0)
RGB = {"rgb8": ASIS, "rgba8": ASIS, "bgr8": SWAPPED, "bgra8": SWAPPED, "8UC3": SWAPPED, "mono8": (0, 0, 0)}
DEPTHS = ("16UC1", "mono16")
PARAMETERS = color.COLOR_CONFIG


class ImageEncoder:
    """Encoder of the images of one camera."""

    def __init__(self, codec: str, bitrate: int = 0) -> None:
        """Make an encoder; `bitrate` is the bytes per second of video that are not exceeded, 0 for the default."""
        self._codec = codec
        self._color: color.ColorEncoder | None = None
        self._depth: depth.DepthEncoder | None = None
        if codec in COLOR:
            config = color.ColorConfig(cast(color.Format, codec), bitrate or PARAMETERS.rate)
            self._color = color.ColorEncoder(config)
        else:
            self._depth = depth.DepthEncoder(cast(depth.Format, codec))

    def request_key(self) -> None:
        """Make the next packet a key frame."""
        if self._color is not None:
            self._color.request_key()

    def set_bitrate(self, bitrate: int) -> None:
        """Set the bytes per second."""
        if self._color is not None:
            self._color.set_rate(bitrate)

    def encode(self, image: Array, encoding: str, header: Header = Header()) -> tuple[PackedImage, bytes]:  # noqa: B008
        """Return an image as a packet, with its head.

        Args:
            image: Pixels (height, width), or (height, width, channels).
            encoding: Their encoding.
            header: Header of the image.

        Raises:
            ConversionError: The codec is not for such images.
        """
        height, width = image.shape[:2]
        try:
            if self._color is not None:
                packet, encoding = self._color.encode(as_rgb(image, encoding)), "rgb8"
            else:
                packet = cast(depth.DepthEncoder, self._depth).encode(_as_depth(image, encoding, self._codec))
        except InvalidRequest as error:
            raise ConversionError(str(error), field="data") from None
        sizes = {"height": height, "width": width}
        head = PackedImage(
            header=header, codec=self._codec, encoding=encoding, number=packet.number, key=packet.key, **sizes
        )
        return head, packet.data


class ImageDecoder:
    """Decoder of the packets of one encoder."""

    def __init__(self, codec: str) -> None:
        """Make a decoder; that of video waits for a key frame."""
        self._color = color.ColorDecoder(cast(color.Format, codec)) if codec in COLOR else None
        self._depth = depth.DepthDecoder()

    def decode(self, head: PackedImage, data: bytes) -> Array | None:
        """Return the image: rgb8 (height, width, 3) or depth (height, width) uint16; None until a key frame comes.

        Raises:
            ConversionError: The packet is damaged.
        """
        packet = Packet(head.number, head.key, data)
        try:
            return self._color.decode(packet) if self._color is not None else self._depth.decode(packet)
        except InvalidRequest as error:
            raise ConversionError(str(error), field="data") from None


def as_rgb(image: Array, encoding: str) -> NDArray[np.uint8]:
    """Return colour or grey pixels as (height, width, 3), red, green, blue; raises ConversionError."""
    if encoding not in RGB:
        raise ConversionError(
            f"video takes images in {', '.join(RGB)}, not in {encoding[:40]!r}: use a codec for depth", field="encoding"
        )
    if encoding == "rgb8":
        return image
    planes = image.reshape(*image.shape[:2], -1)
    return np.ascontiguousarray(planes[:, :, RGB[encoding]])


def _as_depth(image: Array, encoding: str, codec: str) -> NDArray[np.uint16]:
    if encoding not in DEPTHS or image.ndim != 2:
        raise ConversionError(
            f"the codec {codec} takes images in {' or '.join(DEPTHS)}, not in {encoding[:40]!r}", field="encoding"
        )
    return image
