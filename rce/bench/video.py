"""Size, time and delay of the video formats on recorded images with depth."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import msgspec
import numpy as np
from numpy.typing import NDArray

from rce.bench.report import aligned
from rce.errors import InvalidRequest
from rce.video import color, depth
from rce.video.packet import Packet

FREQUENCY = 30  # images per second, for bytes per second
Array = NDArray[Any]


class Figures(msgspec.Struct, frozen=True):
    """Measurements of one format with the images of one kind.

    Attributes:
        images: `color` or `depth`.
        format: Name of the format.
        rate: Megabytes per second at 30 Hz.
        saved: Share of the raw size that is saved.
        encode: Milliseconds of one core for an image, on average.
        decode: Milliseconds of one core for an image, on average.
        delay: Images that went in before the first came out, beyond that one.
        exact: Whether every image came out bit for bit.
    """

    images: str
    format: str
    rate: float
    saved: float
    encode: float
    decode: float
    delay: int
    exact: bool


@dataclass(frozen=True, slots=True)
class Coder:
    """An encoder and a decoder."""

    encode: Callable[[Array], Packet]
    decode: Callable[[Packet], Array | None]


def read(directory: Path, limit: int) -> tuple[list[Array], list[Array]]:
    """Return the first images of a recording: colour (height, width, 3) uint8, and depth (height, width) uint16.

    Args:
        directory: Holds pairs `NAME.color.jpg` or `.png` and `NAME.depth.png`, as those of 7-Scenes.
        limit: Number of pairs.

    Raises:
        InvalidRequest: There are none.
    """
    depths = sorted(directory.glob("*.depth.png"))[:limit]
    names = [path.name.removesuffix(".depth.png") for path in depths]
    found = [next(iter(sorted(directory.glob(f"{name}.color.*"))), None) for name in names]
    colors = [path for path in found if path is not None]
    if not depths or len(colors) != len(depths):
        raise InvalidRequest(f"{directory} has no pairs of NAME.color.jpg and NAME.depth.png", field="recording")
    return [_image(path, "rgb24") for path in colors], [_image(path, "gray16le") for path in depths]


def _image(path: Path, format: str) -> Array:
    with av.open(str(path)) as container:
        return next(container.decode(video=0)).to_ndarray(format=format)


def measure(colors: Sequence[Array], depths: Sequence[Array]) -> Iterable[Figures]:
    """Yield the figures of each format, of images of one size."""
    raw = Coder(lambda image: Packet(0, True, image.tobytes()), lambda packet: np.frombuffer(packet.data, np.uint8))
    yield _measure("color", "raw", raw, colors)
    for name in color.FORMATS:
        encoder, decoder = color.ColorEncoder(color.ColorConfig(name)), color.ColorDecoder(name)
        yield _measure("color", name, Coder(encoder.encode, decoder.decode), colors)
    raw = Coder(raw.encode, lambda packet: np.frombuffer(packet.data, np.uint16))
    yield _measure("depth", "raw", raw, depths)
    for each in depth.FORMATS:
        lossless, back = depth.DepthEncoder(each), depth.DepthDecoder()
        yield _measure("depth", each, Coder(lossless.encode, back.decode), depths)


def _measure(kind: str, name: str, coder: Coder, images: Sequence[Array]) -> Figures:
    size, encoding, decoding, came, exact = 0, 0.0, 0.0, 0, True
    for image in images:
        start = time.thread_time()
        packet = coder.encode(image)
        between = time.thread_time()
        result = coder.decode(packet)
        decoding += time.thread_time() - between
        encoding += between - start
        size += len(packet.data)
        came += result is not None
        exact = exact and result is not None and np.array_equal(result.reshape(-1), image.reshape(-1))
    count, raw = len(images), sum(image.nbytes for image in images)
    rate = size / count * FREQUENCY / 1e6
    times = 1000 * encoding / count, 1000 * decoding / count
    return Figures(kind, name, rate, 1 - size / raw, *times, count - came, exact)


def as_text(figures: Iterable[Figures]) -> str:
    """Return the figures as a table."""
    head = ["images", "format", "MB/s", "saved", "encode ms", "decode ms", "delay", "bit for bit"]
    rows = [
        [
            *(each.images, each.format, f"{each.rate:.2f}", f"{each.saved:.1%}"),
            *(f"{each.encode:.1f}", f"{each.decode:.1f}", str(each.delay), "yes" if each.exact else "no"),
        ]
        for each in figures
    ]
    return "\n".join(aligned([head, *rows]))
