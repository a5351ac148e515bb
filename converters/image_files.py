"""The insides of PNG and JPEG files: their size before anything is decoded, and a note on the message they came from.

Formats: PNG, W3C Recommendation 2003, 5 and 11; JPEG, ITU-T T.81, annex B.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from zlib import crc32

import msgspec

from converters.fitting import Misfit
from converters.wire import Buffer

MAX_PIXEL_BYTES = 300_000_000  # 100 megapixels in colour: a small file can hold any number of white pixels
MAX_SCANS = 64  # of a progressive JPEG; each costs a pass over all pixels and needs a few bytes only
MAX_CHUNKS = 100_000

_PNG = b"\x89PNG\r\n\x1a\n"
# By colour type: samples a pixel in the file, channels after decoding (palettes and gray with alpha become colour).
_PNG_COLOURS = {0: (1, 1), 2: (3, 3), 3: (1, 4), 4: (2, 4), 6: (4, 4)}
_PNG_NEEDED = frozenset({b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND"})
_KEYWORD = b"ros2"
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # JPEG's start of frame markers
_BARE = frozenset({0x00, 0x01, *range(0xD0, 0xDA)})  # markers without a length


class Note(msgspec.Struct, frozen=True):
    """What the message said beside its pixels."""

    stamp: tuple[int, int] = (0, 0)
    frame_id: str = ""
    encoding: str = ""


def checked(data: Buffer) -> tuple[Buffer, Note]:
    """The picture, safe to decode, and the note in it; Misfit if it is no picture, damaged or too large."""
    view = memoryview(data).cast("B")
    start = bytes(view[:8])
    try:
        if start == _PNG:
            return _checked_png(view)
        if start.startswith(b"\xff\xd8\xff"):
            return view, _checked_jpeg(view)
    except (struct.error, IndexError):
        raise Misfit("the picture is cut off") from None
    raise Misfit("the blob is neither PNG nor JPEG")


def with_note(data: bytes, note: Note) -> bytes:
    """The picture (PNG or JPEG) with `note` in it: a tEXt chunk after the header, a comment after the first marker."""
    text = _KEYWORD + b"\0" + msgspec.json.encode(note)
    if data.startswith(_PNG):
        body = b"tEXt" + text
        return b"".join((data[:33], struct.pack(">I", len(text)), body, struct.pack(">I", crc32(body)), data[33:]))
    if len(text) > 65533:
        return data
    return b"".join((data[:2], b"\xff\xfe", struct.pack(">H", len(text) + 2), text, data[2:]))


def _checked_png(view: memoryview) -> tuple[Buffer, Note]:
    """Only the chunks that make the pixels are kept: decoders allocate what the others (and animations) ask for."""
    first, width, height, bits, colour = struct.unpack_from(">4sIIBB", view, 12)
    if first != b"IHDR" or colour not in _PNG_COLOURS:
        raise Misfit("the PNG does not begin with a valid header")
    samples, channels = _PNG_COLOURS[colour]
    _check_size(width, height, channels * (2 if bits == 16 else 1))
    _check_share(height * (width * samples * bits // 8), view)
    note, kept = Note(), [view[:8]]
    for kind, start, end in _png_chunks(view):
        if kind in _PNG_NEEDED and (kind != b"IHDR" or start == 8):
            kept.append(view[start:end])
        elif kind == b"tEXt":
            note = _parse(view[start + 8 : end - 4]) or note
    return b"".join(kept), note


def _png_chunks(view: memoryview) -> Iterator[tuple[bytes, int, int]]:
    """Kind, start and end of each chunk to the last, IEND; struct.error if it is missing."""
    pos = 8
    for _ in range(MAX_CHUNKS):
        size, kind = struct.unpack_from(">I4s", view, pos)
        end = pos + size + 12
        if end > len(view):
            raise Misfit("the picture is cut off")
        yield kind, pos, end
        if kind == b"IEND":
            return
        pos = end
    raise Misfit(f"the PNG has more than {MAX_CHUNKS} chunks")


def _checked_jpeg(view: memoryview) -> Note:
    if bytes(view).count(b"\xff\xda") > MAX_SCANS:
        raise Misfit(f"the JPEG has more than {MAX_SCANS} scans")
    note = Note()
    for marker, start, size in _jpeg_segments(view):
        if marker == 0xFE:
            note = _parse(view[start : start + size]) or note
        if marker in _FRAMES:
            height, width, channels = struct.unpack_from(">HHB", view, start + 1)
            _check_size(width, height, channels)
            _check_share(width * height, view)
            return note
    raise Misfit("the JPEG has no frame")


def _jpeg_segments(view: memoryview) -> Iterator[tuple[int, int, int]]:
    """Marker, start and size of the segments before the pixels, at most a thousand; it ends at what has no place there.

    Decoders skip garbage. Where they go on, they would find another frame than the one that is checked here.
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
        raise Misfit(f"the picture of {width} x {height} is too large: {MAX_PIXEL_BYTES} bytes of pixels are the limit")


def _check_share(least: int, view: memoryview) -> None:
    """Deflate packs at most 1032 bytes into one; a JPEG spends a bit on every 64 pixels, or 512 pixels on a byte."""
    if least > 1032 * len(view):
        raise Misfit("the picture is cut off: its file is too short for its size")


def _parse(text: memoryview) -> Note | None:
    """Our note, or None for a text of another program."""
    keyword, _, body = bytes(text).partition(b"\0")
    if keyword != _KEYWORD:
        return None
    try:
        note = msgspec.json.decode(body, type=Note)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
    return note
