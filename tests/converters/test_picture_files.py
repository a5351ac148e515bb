"""Picture files that are damaged, forged or made to exhaust memory."""

from __future__ import annotations

import io
import json
import struct
from contextlib import suppress

import msgspec
import pytest
from pictures import RNG, cdr_of, fields, image_codec, jpeg, picture, png, random_pixels, whole

from converters import TypeRegistry
from converters.image_files import MAX_PIXEL_BYTES, Note, checked, with_note
from rce.errors import ConversionError

BARE = (b"\0", b"\1", b"\xd0", b"\xd7", b"\xd8")  # markers of JPEG without a length


@pytest.mark.parametrize(("mode", "encoding"), [("1", "mono8"), ("L", "mono8"), ("P", "rgb8"), ("LA", "rgba8")])
def test_other_kinds_of_png(registry: TypeRegistry, mode: str, encoding: str) -> None:
    """Large and of one colour, so that the file is as small as it can be."""
    image, file = pytest.importorskip("PIL.Image"), io.BytesIO()
    image.new(mode, (800, 600)).save(file, "PNG")
    assert fields(registry, image_codec(registry).encode(whole(file.getvalue())))["encoding"] == encoding


@pytest.mark.parametrize("note", [{"stamp": [2**40, 0]}, {"stamp": [0, -1]}, {"frame_id": "\0"}])
def test_a_forged_note_cannot_break_the_message(registry: TypeRegistry, note: dict[str, object]) -> None:
    data = with_note(png(4, 4, data=bytes(20)), Note())
    own = msgspec.json.encode(Note())
    forged = json.dumps({**json.loads(own), **note}).encode()
    at = data.index(own)
    size = struct.pack(">I", len(forged) + 5)
    blob = data[:33] + size + data[37:at] + forged + data[at + len(own) :]
    with pytest.raises(ConversionError) as caught:
        image_codec(registry).encode(whole(blob))
    assert caught.value.field.startswith("header.")


def test_a_note_of_another_shape_is_no_note(registry: TypeRegistry) -> None:
    own = msgspec.json.encode(Note())
    data = with_note(png(4, 4, data=bytes(20)), Note()).replace(own, b"[" * len(own))
    assert fields(registry, image_codec(registry).encode(whole(data)))["header"]["frame_id"] == ""


@pytest.mark.parametrize(
    "bomb",
    [
        png(20_000, 20_000),
        png(2**31 - 1, 2**31 - 1),
        png(10_000, 10_000, 16, 6),
        png(20_000, 6_000, 8, 3),
        jpeg(65_535, 65_535),
    ],
)
def test_bombs_are_refused_by_their_header(registry: TypeRegistry, bomb: bytes) -> None:
    with pytest.raises(ConversionError, match=f"{MAX_PIXEL_BYTES} bytes"):
        image_codec(registry).encode(whole(bomb))


def test_bombs_behind_a_harmless_header_are_refused(registry: TypeRegistry) -> None:
    """Decoders skip what they do not know, so they would find the second header."""
    large, small = png(20_000, 20_000), png(4, 4)
    renamed = small[:12] + b"zzzz" + small[16:33]
    skipped = jpeg(60_000, 60_000)[2:]  # its first two bytes, ff e0, make the length of a marker that has none
    bare = [b"\xff\xd8\xff" + marker + skipped + bytes(0xFFE0 - len(skipped)) + jpeg(8, 8)[2:] for marker in BARE]
    for blob in (renamed + large[8:], *bare):
        with pytest.raises(ConversionError, match=r"header|no frame"):
            image_codec(registry).encode(whole(blob))
    data, _ = checked(small[:33] + large[8:])
    assert bytes(data).count(b"IHDR") == 1


def test_a_jpeg_of_many_scans_is_refused(registry: TypeRegistry) -> None:
    with pytest.raises(ConversionError, match="scans"):
        image_codec(registry).encode(whole(jpeg(8, 8) + b"\xff\xda\0\2" * 100))


@pytest.mark.parametrize(
    "blob",
    [
        b"",
        b"\x89PNG\r\n\x1a\n",
        b"GIF89a" + bytes(100),
        b"BM" + bytes(100),
        bytes(1000),
        b"\xff\xd8\xff",
        b"\xff\xd8\xff\xd9",
        b"\xff\xd8" + b"\xff" * 5000,
        png(4, 4),
        png(4, 4)[:50],
        png(0, 0),
        png(4, 4, 8, 9),
        jpeg(8, 8),
        jpeg(0, 0),
        b"\xff\xd8" + b"\xff\xe0\0\2" * 5000,
    ],
)
def test_damaged_pictures(registry: TypeRegistry, blob: bytes) -> None:
    with pytest.raises(ConversionError):
        image_codec(registry).encode(whole(blob))


def test_flipped_bytes_never_end_in_another_error(registry: TypeRegistry) -> None:
    png_codec = image_codec(registry)
    cdr = cdr_of(registry, random_pixels("rgb8"), "rgb8")
    for image_format in ("png", "jpeg"):
        data = picture(image_codec(registry, image_format).decode(cdr))
        for _ in range(300):
            broken = bytearray(data)
            for at in RNG.integers(0, len(data), 3):
                broken[at] = RNG.integers(256)
            with suppress(ConversionError):
                assert png_codec.encode(whole(bytes(broken))).startswith(b"\0\1\0\0")
