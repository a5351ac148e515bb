"""Frames as they travel where the cloud tracks: colour and depth of a moment in one message.

`h264`, `av1` and `vp9` with lossless depth need the extra `video`; `jpeg` with depth as PNG does not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, cast

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from rce.errors import InvalidRequest
from rce.mapping3d.camera import Camera
from rce.mapping3d.frames import RgbdFrame

if TYPE_CHECKING:
    from rce.video.color import ColorDecoder, ColorEncoder
    from rce.video.depth import DepthDecoder, DepthEncoder

FORMAT = "rce_frame"  # of a `sensor_msgs/CompressedImage` that carries one
Format = Literal["jpeg", "h264", "av1", "vp9"]
UNITS = 1000.0  # of depth in a metre
MAX_SIDE = 1024  # pixels
QUALITY = 90  # of JPEG


class FrameMessage(msgspec.Struct, array_like=True, frozen=True):
    """A frame.

    Attributes:
        format: Format of the colours. With `jpeg` the depth is a PNG of 16 bits, else a packet of `rce.video.depth`.
        number: Place in the stream, from 0.
        key: Whether the colours can be decoded without those before.
        stamp: Seconds.
        camera: width, height, fx, fy, cx, cy; pixels.
        color: The colours.
        depth: The depths, millimetres.
    """

    format: Format
    number: int
    key: bool
    stamp: float
    camera: tuple[int, int, float, float, float, float]
    color: bytes
    depth: bytes


class FrameEncoder:
    """Encoder of the frames of one camera."""

    def __init__(self, camera: Camera, format: Format = "jpeg") -> None:
        """Make an encoder for a camera.

        Raises:
            ModuleNotFoundError: The format needs the extra `video`.
        """
        self._camera = camera.numbers
        self._format: Format = format
        self._number = 0
        self._color: ColorEncoder | None = None
        self._depth: DepthEncoder | None = None
        if format != "jpeg":
            from rce.video.color import ColorConfig, ColorEncoder
            from rce.video.depth import DepthEncoder

            self._color, self._depth = ColorEncoder(ColorConfig(format)), DepthEncoder()

    def request_key(self) -> None:
        """Make the next frame decodable by itself: one was lost."""
        if self._color is not None:
            self._color.request_key()

    def set_rate(self, rate: int) -> None:
        """Set the bytes per second of the colours of a video; a JPEG stays as large as it is."""
        if self._color is not None:
            self._color.set_rate(rate)

    def encode(self, frame: RgbdFrame) -> bytes:
        """Return a frame as bytes."""
        depth = np.clip(np.round(frame.depth * UNITS), 0, 65534).astype(np.uint16)
        key = True
        if self._color is not None and self._depth is not None:
            packet = self._color.encode(frame.color)
            key, color, content = packet.key, packet.data, self._depth.encode(depth).data
        else:
            bgr = cv2.cvtColor(frame.color, cv2.COLOR_RGB2BGR)
            color = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()
            content = cv2.imencode(".png", depth, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
        message = FrameMessage(self._format, self._number, key, float(frame.stamp), self._camera, color, content)
        self._number += 1
        return msgspec.msgpack.encode(message)


class FrameDecoder:
    """Decoder of the frames of one encoder, or of several after each other."""

    def __init__(self) -> None:
        """Make a decoder."""
        self._format: Format = "jpeg"
        self._color: ColorDecoder | None = None
        self._depth: DepthDecoder | None = None

    def decode(self, data: bytes) -> tuple[RgbdFrame, Camera] | None:
        """Return a frame and its camera; None until the next one that is decodable by itself if one was lost.

        Raises:
            InvalidRequest: The message is damaged, or its format needs the extra `video`.
        """
        try:
            message = msgspec.msgpack.decode(data, type=FrameMessage)
        except msgspec.MsgspecError as error:
            raise InvalidRequest(f"this is not a frame: {error}") from None
        width, height, fx, fy, cx, cy = message.camera
        if not 0 < width <= MAX_SIDE or not 0 < height <= MAX_SIDE or fx <= 0 or fy <= 0:
            raise InvalidRequest(f"frame {message.number} is damaged: its camera makes no sense")
        color, depth = _images(message) if message.format == "jpeg" else self._video(message)
        if color is None:
            return None
        if depth is None or color.shape[:2] != (height, width) or depth.shape != (height, width):
            raise InvalidRequest(f"frame {message.number} is damaged: its images have not the size of the camera")
        metres = depth.astype(np.float32) / np.float32(UNITS)
        return RgbdFrame(message.stamp, np.asarray(color, np.uint8), metres), Camera(width, height, fx, fy, cx, cy)

    def _video(self, message: FrameMessage) -> _Images:
        try:
            from rce.video.color import ColorDecoder
            from rce.video.color import Format as ColorFormat
            from rce.video.depth import DepthDecoder
            from rce.video.packet import Packet
        except ModuleNotFoundError:
            raise InvalidRequest(
                f"frames in {message.format} need the extra `video` (PyAV) where they are decoded; send jpeg"
            ) from None
        if self._color is None or self._depth is None or self._format != message.format:
            self._format = message.format
            self._color, self._depth = ColorDecoder(cast(ColorFormat, message.format)), DepthDecoder()
        color = self._color.decode(Packet(message.number, message.key, message.color))
        return color, self._depth.decode(Packet(message.number, True, message.depth))


_Images = tuple[NDArray[np.generic] | None, NDArray[np.generic] | None]


def _images(message: FrameMessage) -> _Images:
    color = cv2.imdecode(np.frombuffer(message.color, np.uint8), cv2.IMREAD_COLOR) if message.color else None
    depth = cv2.imdecode(np.frombuffer(message.depth, np.uint8), cv2.IMREAD_UNCHANGED) if message.depth else None
    if color is None or depth is None or depth.dtype != np.uint16:
        raise InvalidRequest(f"frame {message.number} is damaged: an image cannot be read")
    return cv2.cvtColor(color, cv2.COLOR_BGR2RGB), depth
