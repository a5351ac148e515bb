"""Images as PNG, JPEG and JSON."""

from __future__ import annotations

import base64
import io
import json
import struct
from contextlib import suppress
from typing import Any
from zlib import compress, crc32

import cv2
import numpy as np
import pytest
from support import back, text

from converters import Codec, TypeRegistry, Wire
from converters.image_files import MAX_PIXEL_BYTES
from converters.images import ENCODINGS
from rce.errors import ConversionError
from rce.names import parse_type

BLOB = "0123456789abcdef0123456789abcdef"
RNG = np.random.default_rng(1)


def image_codec(registry: TypeRegistry, image_format: Any = "png", name: str = "sensor_msgs/Image") -> Codec:
    return registry.message(parse_type(name), image_format)


def cdr_of(registry: TypeRegistry, pixels: np.ndarray, encoding: str, padding: int = 0, /, **fields: object) -> bytes:
    """An Image message with `padding` bytes at the end of each row."""
    rows = pixels.reshape(len(pixels), -1).view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, padding)))
    value = {"height": len(pixels), "width": pixels.shape[1], "encoding": encoding, "step": rows.shape[1], **fields}
    blob = Wire(False, json.dumps(value | {"data*": BLOB}).encode(), {BLOB: rows.tobytes()})
    return image_codec(registry, "json").encode(blob)


def fields(registry: TypeRegistry, cdr: bytes) -> dict[str, Any]:
    return json.loads(image_codec(registry, "json").decode(cdr).raw)


def whole(blob: bytes) -> Wire:
    return Wire(True, f'"{BLOB}"'.encode(), {BLOB: blob})


def picture(wire: Wire) -> bytes:
    assert wire.whole
    return bytes(wire.blobs[json.loads(wire.raw)])


def random_pixels(encoding: str) -> np.ndarray:
    kind = ENCODINGS[encoding]
    shape = (5, 7, kind.channels) if kind.channels > 1 else (5, 7)
    return RNG.integers(0, 256**kind.depth, shape).astype(f"<u{kind.depth}")


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("padding", [0, 6])
def test_png_keeps_every_pixel_and_the_header(registry: TypeRegistry, encoding: str, padding: int) -> None:
    pixels = random_pixels(encoding)
    header = {"stamp": {"sec": 12, "nanosec": 34}, "frame_id": "caméra"}
    png = image_codec(registry)
    found = png.encode(whole(picture(png.decode(cdr_of(registry, pixels, encoding, padding, header=header)))))
    assert found == cdr_of(registry, pixels, encoding, header=header)


@pytest.mark.parametrize(("encoding", "kind"), [("mono8", 0), ("mono16", 0), ("rgb8", 2), ("rgba8", 6)])
def test_a_plain_png_of_another_program(registry: TypeRegistry, encoding: str, kind: int) -> None:
    pixels = random_pixels(encoding)
    convert = ENCODINGS[encoding].to_file
    data = cv2.imencode(".png", pixels if convert is None else cv2.cvtColor(pixels, convert))[1].tobytes()
    assert data[25] == kind  # its colour type
    assert image_codec(registry).encode(whole(data)) == cdr_of(registry, pixels, encoding)


def test_other_programs_read_our_png(registry: TypeRegistry) -> None:
    pixels = random_pixels("rgb8")
    data = picture(image_codec(registry).decode(cdr_of(registry, pixels, "rgb8")))
    read = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert read is not None
    assert (read[..., ::-1] == pixels).all()
    image = pytest.importorskip("PIL.Image")
    assert (np.asarray(image.open(io.BytesIO(data))) == pixels).all()


def test_big_endian_images(registry: TypeRegistry) -> None:
    pixels = random_pixels("mono16")
    swapped = cdr_of(registry, pixels.byteswap(), "mono16", is_bigendian=1)
    png = image_codec(registry)
    assert png.encode(whole(picture(png.decode(swapped)))) == cdr_of(registry, pixels, "mono16")


@pytest.mark.parametrize(("encoding", "luma"), [("yuv422", 1), ("yuv422_yuy2", 0)])
def test_yuv422_becomes_rgb8(registry: TypeRegistry, encoding: str, luma: int) -> None:
    pixels = np.full((4, 6, 2), 128, np.uint8)
    pixels[..., luma] = 180
    png = image_codec(registry)
    found = fields(registry, png.encode(whole(picture(png.decode(cdr_of(registry, pixels, encoding))))))
    assert (found["encoding"], found["step"]) == ("rgb8", 18)
    assert set(bytes(data_of(found))) <= set(range(186, 196))  # gray of luma 180 by BT.601: (180 - 16) * 1.164


def data_of(found: dict[str, Any]) -> bytes:
    return base64.b64decode(found["data"])


@pytest.mark.parametrize("encoding", ["mono8", "rgb8", "bgr8"])
def test_jpeg(registry: TypeRegistry, encoding: str) -> None:
    channels = ENCODINGS[encoding].channels
    ramp = np.linspace(0, 255, 32 * 32).reshape(32, 32).astype(np.uint8)
    pixels = ramp if channels == 1 else np.stack([ramp, 255 - ramp, ramp // 2], -1)
    jpeg = image_codec(registry, "jpeg")
    header = {"stamp": {"sec": 12, "nanosec": 34}, "frame_id": "cam"}
    data = picture(jpeg.decode(cdr_of(registry, pixels, encoding, header=header)))
    assert data.startswith(b"\xff\xd8\xff")
    assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) is not None
    found = fields(registry, jpeg.encode(whole(data)))
    assert (found["encoding"], found["header"]) == (encoding, header)
    assert np.abs(np.frombuffer(data_of(found), np.uint8).astype(int) - pixels.ravel()).mean() < 8


@pytest.mark.parametrize(
    ("image_format", "encoding", "hint"),
    [
        ("png", "32FC1", "format json or a Forwarder"),
        ("png", "", "format json or a Forwarder"),
        ("jpeg", "mono16", "png"),
        ("jpeg", "rgba8", "png"),
    ],
)
def test_encodings_that_the_format_cannot_hold(
    registry: TypeRegistry, image_format: str, encoding: str, hint: str
) -> None:
    with pytest.raises(ConversionError, match=hint):
        image_codec(registry, image_format).decode(cdr_of(registry, np.zeros((4, 4, 8), np.uint8), encoding))


@pytest.mark.parametrize(
    "wrong",
    [
        {"step": 6},
        {"height": 6},
        {"height": 0},
        {"width": 0},
        {"width": 2**32 - 1, "step": 2**32 - 1, "height": 2**32 - 1},
        {"encoding": "yuv422"},
        {"width": 70_000, "height": 1, "step": 35},
    ],
)
def test_images_whose_fields_contradict_each_other(registry: TypeRegistry, wrong: dict[str, object]) -> None:
    with pytest.raises(ConversionError, match="image"):
        image_codec(registry).decode(cdr_of(registry, random_pixels("mono8"), "mono8", **wrong))


def test_json(registry: TypeRegistry) -> None:
    cdr = cdr_of(registry, random_pixels("rgb8"), "rgb8")
    wire = image_codec(registry, "json").decode(cdr)
    assert not wire.whole
    assert not wire.blobs
    for image_format in ("png", "jpeg", "json"):  # the format is how images leave; they arrive in any
        assert image_codec(registry, image_format).encode(wire) == cdr


def test_images_inside_messages(registry: TypeRegistry) -> None:
    own = TypeRegistry()
    own.learn({"demo/msg/Rig": "string name\nsensor_msgs/Image left\nsensor_msgs/Image[] others\nuint8 end\n"})
    rig, plain = (image_codec(own, image_format, "demo/Rig") for image_format in ("png", "json"))
    one, two = (fields(registry, cdr_of(registry, random_pixels(name), name)) for name in ("rgb8", "mono8"))
    value = {"name": "a", "left": one, "others": [two, one], "end": 7}
    cdr = plain.encode(text(json.dumps(value)))
    wire = rig.decode(cdr)
    found = json.loads(wire.raw)
    assert found.keys() == {"name", "left*", "others*", "end"}
    assert list(wire.blobs) == [found["left*"], *found["others*"]]
    assert rig.encode(wire) == plain.encode(wire) == cdr
    assert json.loads(plain.decode(cdr).raw) == value
    with pytest.raises(ConversionError) as caught:
        rig.encode(wire._replace(blobs=wire.blobs | {found["others*"][1]: b"?"}))
    assert caught.value.field == "others*"


def png(width: int, height: int, bits: int = 8, colour: int = 0, data: bytes = b"") -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", crc32(kind + body))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", compress(data)) + chunk(b"IEND", b"")


def jpeg(width: int, height: int) -> bytes:
    return b"\xff\xd8\xff\xe0\0\4ab\xff\xc2" + struct.pack(">HBHHB", 8, 8, height, width, 3) + b"\xff\xda\0\2"


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
    restart = b"\xff\xd8\xff\xd0" + jpeg(60_000, 60_000)[2:] + bytes(65_472) + jpeg(8, 8)[2:]
    for blob in (
        renamed + large[8:],
        restart,
        restart.replace(b"\xff\xd0", b"\xff\0"),
        b"\xff\xd8\xff\1" + restart[4:],
    ):
        with pytest.raises(ConversionError, match=r"header|no frame"):
            image_codec(registry).encode(whole(blob))
    with pytest.raises(ConversionError, match="damaged|cut off"):
        image_codec(registry).encode(whole(small[:33] + large[8:]))


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


@pytest.mark.parametrize("raw", [b"5", b"", b'"', b'["x"]', b'"\xff"', b"[" * 100_000, b'"unknown"'])
def test_a_whole_message_needs_the_id_of_a_blob(registry: TypeRegistry, raw: bytes) -> None:
    with pytest.raises(ConversionError):
        image_codec(registry).encode(Wire(True, raw, {BLOB: b""}))


def test_an_image_needs_no_blob(registry: TypeRegistry) -> None:
    assert back(image_codec(registry, "json"), {"width": 3})["width"] == 3
