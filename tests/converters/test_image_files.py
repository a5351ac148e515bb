"""Image files that are damaged, forged or made to exhaust memory."""

from __future__ import annotations

import io
import json
import struct
from contextlib import suppress

import msgspec
import pytest

from converters import TypeRegistry
from converters.image_files import MAX_PIXEL_BYTES, Metadata, validate, with_metadata
from rce.errors import ConversionError
from tests.support.converters.images import (
    RNG,
    cdr_of,
    fields,
    image_blob,
    image_codec,
    image_wire,
    jpeg,
    png,
    random_pixels,
)

BARE = (b"\0", b"\1", b"\xd0", b"\xd7", b"\xd8")  # JPEG markers without a length


@pytest.mark.parametrize(("mode", "encoding"), [("1", "mono8"), ("L", "mono8"), ("P", "rgb8"), ("LA", "rgba8")])
def test_all_colour_types_of_png_are_accepted(registry: TypeRegistry, mode: str, encoding: str) -> None:
    """The image is large and of a single colour, so that its compression is as high as possible."""
    image, file = pytest.importorskip("PIL.Image"), io.BytesIO()
    image.new(mode, (800, 600)).save(file, "PNG")
    assert fields(registry, image_codec(registry).encode(image_wire(file.getvalue())))["encoding"] == encoding


@pytest.mark.parametrize("values", [{"stamp": [2**40, 0]}, {"stamp": [0, -1]}, {"frame_id": "\0"}])
def test_forged_metadata_is_validated(registry: TypeRegistry, values: dict[str, object]) -> None:
    data = with_metadata(png(4, 4, data=bytes(20)), Metadata())
    own = msgspec.json.encode(Metadata())
    forged = json.dumps({**json.loads(own), **values}).encode()
    at = data.index(own)
    size = struct.pack(">I", len(forged) + 5)
    blob = data[:33] + size + data[37:at] + forged + data[at + len(own) :]
    with pytest.raises(ConversionError) as caught:
        image_codec(registry).encode(image_wire(blob))
    assert caught.value.field.startswith("header.")


def test_malformed_metadata_is_ignored(registry: TypeRegistry) -> None:
    own = msgspec.json.encode(Metadata())
    data = with_metadata(png(4, 4, data=bytes(20)), Metadata()).replace(own, b"[" * len(own))
    assert fields(registry, image_codec(registry).encode(image_wire(data)))["header"]["frame_id"] == ""


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
def test_decompression_bomb_is_rejected_by_its_header(registry: TypeRegistry, bomb: bytes) -> None:
    with pytest.raises(ConversionError, match=f"{MAX_PIXEL_BYTES} bytes"):
        image_codec(registry).encode(image_wire(bomb))


def test_decompression_bomb_behind_a_harmless_header_is_rejected(registry: TypeRegistry) -> None:
    """Decoders skip unknown data, so they would find the second header."""
    large, small = png(20_000, 20_000), png(4, 4)
    renamed = small[:12] + b"zzzz" + small[16:33]
    skipped = jpeg(60_000, 60_000)[2:]  # its first two bytes, ff e0, look like the length of a marker that has none
    bare = [b"\xff\xd8\xff" + marker + skipped + bytes(0xFFE0 - len(skipped)) + jpeg(8, 8)[2:] for marker in BARE]
    for blob in (renamed + large[8:], *bare):
        with pytest.raises(ConversionError, match=r"header|no frame"):
            image_codec(registry).encode(image_wire(blob))
    data, _ = validate(small[:33] + large[8:])
    assert bytes(data).count(b"IHDR") == 1


def test_jpeg_with_too_many_scans_is_rejected(registry: TypeRegistry) -> None:
    with pytest.raises(ConversionError, match="scans"):
        image_codec(registry).encode(image_wire(jpeg(8, 8) + b"\xff\xda\0\2" * 100))


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
def test_damaged_file_is_rejected(registry: TypeRegistry, blob: bytes) -> None:
    with pytest.raises(ConversionError):
        image_codec(registry).encode(image_wire(blob))


def test_flipped_bytes_raise_only_conversion_errors(registry: TypeRegistry) -> None:
    png_codec = image_codec(registry)
    cdr = cdr_of(registry, random_pixels("rgb8"), "rgb8")
    for image_format in ("png", "jpeg"):
        data = image_blob(image_codec(registry, image_format).decode(cdr))
        for _ in range(300):
            broken = bytearray(data)
            for at in RNG.integers(0, len(data), 3):
                broken[at] = RNG.integers(256)
            with suppress(ConversionError):
                assert png_codec.encode(image_wire(bytes(broken))).startswith(b"\0\1\0\0")
