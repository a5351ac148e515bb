"""Validation of PNG and JPEG files before they are decoded, and metadata of the ROS message in them.

Untrusted files are checked for their size in pixels and for constructs that make decoders slow or hungry for memory.
Formats: PNG, W3C Recommendation 2003, sections 5 and 11; JPEG, ITU-T T.81, annex B.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from zlib import crc32

import msgspec

from converters.scalars import FieldError
from converters.wire import Buffer

MAX_PIXEL_BYTES = 1 << 26  # the largest message; 22 megapixels in colour. A small file can hold very many white pixels
MAX_SCANS = 64  # of a progressive JPEG; each costs a pass over all pixels but only a few bytes
MAX_CHUNKS = 100_000

_PNG = b"\x89PNG\r\n\x1a\n"
# By colour type: samples per pixel in the file, channels after decoding (palettes and gray with alpha become colour).
_PNG_COLOURS = {0: (1, 1), 2: (3, 3), 3: (1, 4), 4: (2, 4), 6: (4, 4)}
_PNG_NEEDED = frozenset({b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND"})
_KEYWORD = b"ros2"
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # start-of-frame markers of JPEG
_BARE = frozenset({0x00, 0x01, *range(0xD0, 0xDA)})  # markers without a length


class Metadata(msgspec.Struct, frozen=True):
    """Fields of a `sensor_msgs/Image` that an image file has no place for."""

    stamp: tuple[int, int] = (0, 0)
    frame_id: str = ""
    encoding: str = ""


def validate(data: Buffer) -> tuple[Buffer, Metadata]:
    """Return a file that is safe to decode and the metadata in it.

    Raises:
        FieldError: The data is not a PNG or JPEG file, or the image is damaged or too large.
    """
    view = memoryview(data).cast("B")
    start = bytes(view[:8])
    try:
        if start == _PNG:
            return _validate_png(view)
        if start.startswith(b"\xff\xd8\xff"):
            return view, _validate_jpeg(view)
    except (struct.error, IndexError):
        raise FieldError("the image file is truncated") from None
    raise FieldError("the blob is neither PNG nor JPEG")


def with_metadata(data: bytes, metadata: Metadata) -> bytes:
    """Return an image file with metadata in it.

    In a PNG it is a tEXt chunk after the header, in a JPEG a comment after the first marker (omitted if too long).
    """
    text = _KEYWORD + b"\0" + msgspec.json.encode(metadata)
    if data.startswith(_PNG):
        body = b"tEXt" + text
        return b"".join((data[:33], struct.pack(">I", len(text)), body, struct.pack(">I", crc32(body)), data[33:]))
    if len(text) > 65533:
        return data
    return b"".join((data[:2], b"\xff\xfe", struct.pack(">H", len(text) + 2), text, data[2:]))


def _validate_png(view: memoryview) -> tuple[Buffer, Metadata]:
    """Keep only the chunks of the pixels: for others, such as animations, decoders allocate what they declare."""
    first, width, height, bits, colour = struct.unpack_from(">4sIIBB", view, 12)
    if first != b"IHDR" or colour not in _PNG_COLOURS:
        raise FieldError("the PNG does not begin with a valid header")
    samples, channels = _PNG_COLOURS[colour]
    _check_size(width, height, channels * (2 if bits == 16 else 1))
    _check_compression(height * (width * samples * bits // 8), view)
    metadata, kept = Metadata(), [view[:8]]
    for kind, start, end in _png_chunks(view):
        if kind in _PNG_NEEDED and (kind != b"IHDR" or start == 8):
            kept.append(view[start:end])
        elif kind == b"tEXt":
            metadata = _parse(view[start + 8 : end - 4]) or metadata
    return b"".join(kept), metadata


def _png_chunks(view: memoryview) -> Iterator[tuple[bytes, int, int]]:
    """Yield type, start and end of each chunk up to IEND; raises struct.error if that is missing."""
    pos = 8
    for _ in range(MAX_CHUNKS):
        size, kind = struct.unpack_from(">I4s", view, pos)
        end = pos + size + 12
        if end > len(view):
            raise FieldError("the image file is truncated")
        yield kind, pos, end
        if kind == b"IEND":
            return
        pos = end
    raise FieldError(f"the PNG has more than {MAX_CHUNKS} chunks")


def _validate_jpeg(view: memoryview) -> Metadata:
    if bytes(view).count(b"\xff\xda") > MAX_SCANS:
        raise FieldError(f"the JPEG has more than {MAX_SCANS} scans")
    metadata = Metadata()
    for marker, start, size in _jpeg_segments(view):
        if marker == 0xFE:
            metadata = _parse(view[start : start + size]) or metadata
        if marker in _FRAMES:
            height, width, channels = struct.unpack_from(">HHB", view, start + 1)
            _check_size(width, height, channels)
            _check_compression(width * height, view)
            return metadata
    raise FieldError("the JPEG has no frame")


def _jpeg_segments(view: memoryview) -> Iterator[tuple[int, int, int]]:
    """Yield marker, start and size of the segments before the pixels, at most a thousand.

    This ends at the first byte that is not a segment. Decoders would skip such garbage, and could find another frame
    header behind it than the one that is validated here.
    """
    pos = 2
    for _ in range(1000):
        while view[pos] == 0xFF and view[pos + 1] == 0xFF:  # fill bytes
            pos += 1
        mark, marker, size = struct.unpack_from(">BBH", view, pos)
        if mark != 0xFF or marker in _BARE or marker == 0xDA:
            return
        yield marker, pos + 4, size - 2
        pos += size + 2


def _check_size(width: int, height: int, pixel: int) -> None:
    if width * height * pixel > MAX_PIXEL_BYTES:
        raise FieldError(
            f"the image of {width} x {height} is too large: a message has at most {MAX_PIXEL_BYTES} bytes of pixels"
        )


def _check_compression(size: int, view: memoryview) -> None:
    """Reject a file that is too short for its pixels.

    Deflate compresses at most 1032 bytes into one; a JPEG needs at least one bit per 64 pixels, a byte per 512 pixels.
    """
    if size > 1032 * len(view):
        raise FieldError("the image file is truncated: it is too short for its size in pixels")


def _parse(text: memoryview) -> Metadata | None:
    """Return the metadata, or None if another program wrote the text."""
    keyword, _, body = bytes(text).partition(b"\0")
    if keyword != _KEYWORD:
        return None
    try:
        metadata = msgspec.json.decode(body, type=Metadata)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
    return metadata
