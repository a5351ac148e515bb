"""Depth images without loss, each by itself, so that a dropped packet costs one image.

Cameras with structured light produce a few hundred distinct depths. `palette` sends these as a table, and the image of
their places in it as FFV1 (RFC 9043): neighbouring places differ less than neighbouring depths.

A packet is, little endian:

    format 1 | height 2 | width 2 | values 2 | size of the configuration 2 | values 2 each | configuration | image

where values and configuration (that of FFV1) are missing in formats that have none.
"""

from __future__ import annotations

import struct
from fractions import Fraction
from typing import Literal

import av
import av.error
import numpy as np
from av.video.codeccontext import VideoCodecContext
from numpy.typing import NDArray

from rce.errors import InvalidRequest
from rce.video.packet import Packet

Depth = NDArray[np.uint16]  # (height, width), 0 = none; any unit
Format = Literal["palette", "ffv1", "png"]
FORMATS: tuple[Format, ...] = ("palette", "ffv1", "png")

HEAD = struct.Struct("<BHHHH")
MAX_VALUES = 4096  # of a palette; with more of them plain FFV1 is as small
MAX_PIXELS = 1 << 24
FFV1 = {"level": "3", "slicecrc": "0"}
PNG = {"compression_level": "3"}


class DepthEncoder:
    """Encoder of the depth images of one camera."""

    def __init__(self, format: Format = "palette") -> None:
        """Make an encoder. It takes its size from the first image."""
        self._format: Format = format
        self._context: VideoCodecContext | None = None
        self._number = 0

    def encode(self, depth: Depth) -> Packet:
        """Encode an image (height, width) uint16. An image with many distinct values is plain FFV1 even so.

        Raises:
            InvalidRequest: The image is empty or has more than 16 million pixels.
        """
        height, width = depth.shape
        if not 0 < height * width <= MAX_PIXELS or max(height, width) > 65535:
            raise InvalidRequest(f"a depth image of {width}x{height} cannot be encoded: at most {MAX_PIXELS:,} pixels")
        if self._context is None or (self._context.width, self._context.height) != (width, height):
            self._context = _open_encoder(self._format, width, height)
        format, values, image = self._format, np.empty(0, np.uint16), depth
        if format == "palette":
            present = np.bincount(depth.reshape(-1), minlength=65536) > 0
            values = np.flatnonzero(present).astype(np.uint16)
            if len(values) > MAX_VALUES:
                format, values = "ffv1", values[:0]
            else:
                image = (np.cumsum(present) - 1).astype(np.uint16)[depth]
        configuration = self._context.extradata or b""
        head = HEAD.pack(FORMATS.index(format), height, width, len(values), len(configuration))
        body = self._encode(self._context, image)
        number, self._number = self._number, self._number + 1
        return Packet(number, True, head + values.astype("<u2").tobytes() + configuration + body)

    def _encode(self, context: VideoCodecContext, image: Depth) -> bytes:
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format=context.pix_fmt or "")
        frame.pts = self._number
        (packet,) = context.encode(frame)
        return bytes(packet)


class DepthDecoder:
    """Decoder of the packets of one encoder; they carry their format."""

    def __init__(self) -> None:
        """Make a decoder."""
        self._context: VideoCodecContext | None = None
        self._made_for: tuple[int, int, int, bytes] | None = None  # format, height, width, configuration

    def decode(self, packet: Packet) -> Depth:
        """Return the image (height, width) uint16, exactly as it was encoded.

        Raises:
            InvalidRequest: The packet is damaged.
        """
        data = packet.data
        if len(data) < HEAD.size:
            raise InvalidRequest(f"a packet of depth has {len(data)} bytes; its head has {HEAD.size}")
        format, height, width, count, size = HEAD.unpack_from(data)
        if format >= len(FORMATS) or not 0 < height * width <= MAX_PIXELS or count > MAX_VALUES:
            raise InvalidRequest(f"a packet of depth is damaged: format {format}, {width}x{height}, {count} values")
        start = HEAD.size + 2 * count + size
        if len(data) <= start:
            raise InvalidRequest(f"a packet of depth is cut off: {len(data)} bytes, the image begins at {start}")
        values = np.frombuffer(data, "<u2", count, HEAD.size)
        image = self._image((format, height, width, data[HEAD.size + 2 * count : start]), data[start:])
        if not count:
            return image
        if int(image.max()) >= count:
            raise InvalidRequest(f"a packet of depth is damaged: place {image.max()} in a table of {count} values")
        return values.astype(np.uint16)[image]

    def _image(self, wanted: tuple[int, int, int, bytes], body: bytes) -> Depth:
        if self._context is None or self._made_for != wanted or FORMATS[wanted[0]] == "png":
            # FFmpeg's decoder of PNG mixes an image with the one before it, as in an animation: each gets a new one.
            self._context, self._made_for = _open_decoder(*wanted), wanted
        try:
            frames = self._context.decode(av.Packet(body))
            images = [frame.to_ndarray(format="gray16le") for frame in frames]
        except (av.error.FFmpegError, ValueError) as error:
            self._context = None
            raise InvalidRequest(f"a packet of depth is damaged: {error}") from None
        if len(images) != 1 or images[0].shape != wanted[1:3]:
            self._context = None
            shapes = ", ".join(str(each.shape) for each in images) or "none"
            raise InvalidRequest(f"a packet of depth is damaged: images of {shapes} instead of {wanted[1:3]}")
        return np.asarray(images[0], np.uint16)


def _open_encoder(format: Format, width: int, height: int) -> VideoCodecContext:
    context = av.CodecContext.create("png" if format == "png" else "ffv1", "w")
    assert isinstance(context, VideoCodecContext)  # the names are those of video codecs
    context.width, context.height = width, height
    context.pix_fmt = "gray16be" if format == "png" else "gray16le"
    context.time_base, context.gop_size, context.thread_count = Fraction(1, 30), 1, 1
    context.options = PNG if format == "png" else FFV1
    context.open()
    return context


def _open_decoder(format: int, height: int, width: int, configuration: bytes) -> VideoCodecContext:
    context = av.CodecContext.create("png" if FORMATS[format] == "png" else "ffv1", "r")
    assert isinstance(context, VideoCodecContext)
    context.thread_count = 1  # each further thread would delay the images by one
    if configuration:
        context.width, context.height, context.extradata = width, height, configuration
    return context
