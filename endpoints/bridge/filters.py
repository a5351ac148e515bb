"""What happens to messages on their way: left out because they come too soon, compressed, or reduced to some frames."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from typing import Any, Literal

import msgspec

from converters.types import TypeRegistry
from converters.wire import Wire
from rce.blobs import Buffer
from rce.errors import ConversionError
from rce.names import parse_type

Filter = Callable[[Buffer], Any]
"""Takes CDR and gives what is sent on, None for nothing; ConversionError."""

IMAGE, TF = parse_type("sensor_msgs/Image"), parse_type("tf2_msgs/TFMessage")


class Pace:
    """Lets through what comes no sooner than the rate in Hz allows; 0 lets everything through."""

    def __init__(self, rate: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._pause = 1 / rate if rate else 0.0
        self._clock = clock
        self._next = 0.0

    def due(self) -> bool:
        now = self._clock()
        if now < self._next:
            return False
        following = self._next + self._pause  # not from now on, so that the mean rate is kept
        self._next = following if following > now else now + self._pause
        return True


def as_picture(format: Literal["png", "jpeg"]) -> Filter:
    """`sensor_msgs/Image` as the bytes of a picture file."""
    codec = TypeRegistry().message(IMAGE, format)

    def compress(cdr: Buffer) -> Buffer:
        wire = codec.decode(cdr)
        if not wire.whole:
            raise ConversionError(f"images of this encoding cannot be sent as {format}: leave format empty")
        return next(iter(wire.blobs.values()))

    return compress


def from_picture() -> Filter:
    """The bytes of a picture file as `sensor_msgs/Image`."""
    codec = TypeRegistry().message(IMAGE)

    def unpack(picture: Buffer) -> Buffer:
        name = "0" * 32
        return codec.encode(Wire(True, b'"%b"' % name.encode(), {name: picture}))

    return unpack


def chosen_transforms(frames: Collection[str], rate: float, clock: Callable[[], float] = time.monotonic) -> Filter:
    """Of a `tf2_msgs/TFMessage`, the transforms with these child frames, each at `rate` Hz at most."""
    codec = TypeRegistry().message(TF)
    paces = {frame.lstrip("/"): Pace(rate, clock) for frame in frames}

    def choose(cdr: Buffer) -> Buffer | None:
        transforms = msgspec.json.decode(codec.decode(cdr).raw)["transforms"]
        kept = [each for each in transforms if (pace := paces.get(each["child_frame_id"].lstrip("/"))) and pace.due()]
        if len(kept) == len(transforms):
            return cdr if kept else None
        return codec.encode(Wire(False, msgspec.json.encode({"transforms": kept}), {})) if kept else None

    return choose
