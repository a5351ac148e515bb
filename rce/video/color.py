"""Colour images as video without delay: each image is decodable as soon as its packet arrives.

The settings are those for live video of FFmpeg's wrappers of x264, SVT-AV1 and libvpx. There are no B-frames, a group
has 30 images, and a key frame carries all parameters, as `foxglove_msgs/CompressedVideo` demands.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Literal

import av
import av.error
import numpy as np
from av.video.codeccontext import VideoCodecContext
from numpy.typing import NDArray

from rce.errors import InvalidRequest
from rce.video.packet import Packet

Image = NDArray[np.uint8]  # (height, width, 3), red, green, blue
Format = Literal["h264", "av1", "vp9"]
FORMATS: tuple[Format, ...] = ("h264", "av1", "vp9")

GROUP = 30  # images from one key frame to the next
MAX_SIDE = 4096  # pixels
THREADS = "/proc/self/task"  # directory with the threads of this process


@dataclass(frozen=True, slots=True)
class ColorConfig:
    """Settings of an encoder.

    Attributes:
        format: Format of the video.
        rate: Bytes per second that are not exceeded, on average over a second.
        frequency: Images per second.
    """

    format: Format = "h264"
    rate: int = 500_000
    frequency: int = 30


COLOR_CONFIG = ColorConfig()


class ColorEncoder:
    """Encoder of the images of one camera."""

    def __init__(self, config: ColorConfig = COLOR_CONFIG) -> None:
        """Make an encoder. It takes its size from the first image."""
        self._config = config
        self._context: VideoCodecContext | None = None
        self._number = 0

    def request_key(self) -> None:
        """Make the next packet a key frame: somebody has joined, or a packet was dropped."""
        self._context = None

    def set_rate(self, rate: int) -> None:
        """Set the bytes per second; the next packet is a key frame."""
        self._config = replace(self._config, rate=rate)
        self._context = None

    def encode(self, image: Image) -> Packet:
        """Encode an image (height, width, 3), red, green, blue. An image of another size begins with a key frame.

        Raises:
            InvalidRequest: Height or width is odd, larger than 4096, or too small for the format (64 for AV1).
        """
        height, width = image.shape[:2]
        if height % 2 or width % 2 or not 0 < height <= MAX_SIDE or not 0 < width <= MAX_SIDE:
            raise InvalidRequest(f"an image of {width}x{height} cannot be video: sides must be even and <= {MAX_SIDE}")
        if self._context is None or (self._context.width, self._context.height) != (width, height):
            self._context = _open_encoder(self._config, width, height)
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
        frame.pts = self._number
        (packet,) = self._context.encode(frame)
        number, self._number = self._number, self._number + 1
        return Packet(number, packet.is_keyframe, bytes(packet))


class ColorDecoder:
    """Decoder of the packets of one encoder."""

    def __init__(self, format: Format = "h264") -> None:
        """Make a decoder, which waits for a key frame."""
        self._format = format
        self._context: VideoCodecContext | None = None
        self._expected = 0

    @property
    def needs_key(self) -> bool:
        """Return True if nothing can be decoded before a key frame, which the encoder should be asked for."""
        return self._context is None

    def decode(self, packet: Packet) -> Image | None:
        """Return the image (height, width, 3), red, green, blue, or None until a key frame comes after a gap.

        Raises:
            InvalidRequest: The packet is damaged. A key frame is needed then.
        """
        if packet.number != self._expected:
            self._context = None
        self._expected = packet.number + 1
        if packet.key:
            self._context = _open_decoder(self._format)
        if self._context is None:
            return None
        try:
            frames = self._context.decode(av.Packet(packet.data))
        except av.error.FFmpegError as error:
            self._context = None
            raise InvalidRequest(f"a packet of {self._format} video is damaged: {error}") from None
        if len(frames) != 1 or max(frames[0].width, frames[0].height) > MAX_SIDE:
            self._context = None
            raise InvalidRequest(f"a packet of {self._format} video has {len(frames)} usable images; it must have one")
        return np.asarray(frames[0].to_ndarray(format="rgb24"), np.uint8)


def _open_encoder(config: ColorConfig, width: int, height: int) -> VideoCodecContext:
    name, options = ENCODERS[config.format]
    os.environ.setdefault("SVT_LOG", "0")  # else it writes a page about its settings to the standard error
    context = av.CodecContext.create(name, "w")
    assert isinstance(context, VideoCodecContext)  # the names are those of video codecs
    context.width, context.height, context.pix_fmt = width, height, "yuv420p"
    context.time_base, context.framerate = Fraction(1, config.frequency), Fraction(config.frequency)
    context.gop_size, context.max_b_frames, context.thread_count = GROUP, 0, 1
    context.options = options(8 * config.rate)
    try:
        with _same_scheduling():
            context.open()
    except av.error.FFmpegError as error:
        raise InvalidRequest(f"{config.format} cannot encode images of {width}x{height}: {error}") from None
    return context


@contextmanager
def _same_scheduling() -> Iterator[None]:
    """Give the threads that begin in this block the scheduling of this thread, and keep that.

    In a process of root, SVT-AV1 gives its threads and the one that calls it the highest real-time priority. They would
    stop all other programs of the machine while they compute.
    """
    if not hasattr(os, "sched_setscheduler"):  # not Linux
        yield
        return
    scheduling, before = (os.sched_getscheduler(0), os.sched_getparam(0)), set(os.listdir(THREADS))
    try:
        yield
    finally:
        for thread in {"0", *os.listdir(THREADS)} - before:
            with suppress(ProcessLookupError):  # it has ended
                os.sched_setscheduler(int(thread), *scheduling)


def _open_decoder(format: Format) -> VideoCodecContext:
    context = av.CodecContext.create(DECODERS[format], "r")
    assert isinstance(context, VideoCodecContext)
    context.thread_count = 1  # each further thread would delay the images by one
    return context


def _x264(bits: int) -> dict[str, str]:
    """Constant quality up to a rate, with a buffer of half a second."""
    bounds = {"maxrate": str(bits), "bufsize": str(bits // 2)}
    return {"preset": "veryfast", "tune": "zerolatency", "crf": "23", **bounds}


def _svt_av1(bits: int) -> dict[str, str]:
    """Constant rate: this encoder bounds no other mode without delay."""
    return {"preset": "11", "b": str(bits), "svtav1-params": "pred-struct=1:rc=2:rtc=1:lp=1"}


def _vp9(bits: int) -> dict[str, str]:
    """Constant quality up to a rate."""
    return {"deadline": "realtime", "cpu-used": "8", "crf": "33", "b": str(bits), "lag-in-frames": "0"}


ENCODERS: dict[Format, tuple[str, Callable[[int], dict[str, str]]]] = {
    "h264": ("libx264", _x264),
    "av1": ("libsvtav1", _svt_av1),
    "vp9": ("libvpx-vp9", _vp9),
}
DECODERS: dict[Format, str] = {"h264": "h264", "av1": "libdav1d", "vp9": "vp9"}
