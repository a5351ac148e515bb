"""Filters for forwarded messages: rate limit, image compression, and selection of transforms."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from typing import Any, Literal

import msgspec

from converters.types import TypeRegistry
from converters.wire import Wire
from rce.errors import ConversionError
from rce.protocol.blobs import Buffer
from rce.protocol.names import parse_type

Filter = Callable[[Buffer], Any]
"""Returns the value to forward for a message in CDR, or None to drop it; raises ConversionError."""

IMAGE, TF = parse_type("sensor_msgs/Image"), parse_type("tf2_msgs/TFMessage")


class RateLimit:
    """Limit of a message rate in Hz; 0 for no limit."""

    def __init__(self, rate: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._interval = 1 / rate if rate else 0.0
        self._clock = clock
        self._next = 0.0

    def allows(self) -> bool:
        """Return True if a message that comes now is within the rate."""
        now = self._clock()
        if now < self._next:
            return False
        following = self._next + self._interval  # not relative to now, so that the mean rate is kept
        self._next = following if following > now else now + self._interval
        return True


def image_encoder(format: Literal["png", "jpeg"]) -> Filter:
    """Return a filter that encodes `sensor_msgs/Image` as an image file."""
    codec = TypeRegistry().message(IMAGE, format)

    def compress(cdr: Buffer) -> Buffer:
        wire = codec.decode(cdr)
        if not wire.is_blob:
            raise ConversionError(f"images with this encoding cannot be compressed as {format}: leave format empty")
        return next(iter(wire.blobs.values()))

    return compress


def image_decoder() -> Filter:
    """Return a filter that decodes an image file to `sensor_msgs/Image`."""
    codec = TypeRegistry().message(IMAGE)

    def decompress(image: Buffer) -> Buffer:
        name = "0" * 32
        return codec.encode(Wire(True, b'"%b"' % name.encode(), {name: image}))

    return decompress


def transform_filter(frames: Collection[str], rate: float, clock: Callable[[], float] = time.monotonic) -> Filter:
    """Return a filter for `tf2_msgs/TFMessage` that keeps these child frames, each at up to `rate` Hz."""
    codec = TypeRegistry().message(TF)
    limits = {frame.lstrip("/"): RateLimit(rate, clock) for frame in frames}

    def choose(cdr: Buffer) -> Buffer | None:
        transforms = msgspec.json.decode(codec.decode(cdr).raw)["transforms"]
        kept = [
            each for each in transforms if (limit := limits.get(each["child_frame_id"].lstrip("/"))) and limit.allows()
        ]
        if len(kept) == len(transforms):
            return cdr if kept else None
        return codec.encode(Wire(False, msgspec.json.encode({"transforms": kept}), {})) if kept else None

    return choose
