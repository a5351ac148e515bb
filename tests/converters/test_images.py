"""sensor_msgs/Image as PNG, JPEG and JSON."""

from __future__ import annotations

import io
import json

import cv2
import msgspec
import numpy as np
import pytest

from converters import TypeRegistry, Wire
from converters.images import ENCODINGS
from rce.errors import ConversionError
from tests.support.converters.conversions import json_wire, round_trip
from tests.support.converters.images import cdr_of, data_of, fields, image_blob, image_codec, image_wire, random_pixels


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("padding", [0, 6])
def test_png_preserves_pixels_and_header(registry: TypeRegistry, encoding: str, padding: int) -> None:
    pixels = random_pixels(encoding)
    header = {"stamp": {"sec": 12, "nanosec": 34}, "frame_id": "caméra"}
    png = image_codec(registry)
    found = png.encode(image_wire(image_blob(png.decode(cdr_of(registry, pixels, encoding, padding, header=header)))))
    assert found == cdr_of(registry, pixels, encoding, header=header)


@pytest.mark.parametrize(("encoding", "kind"), [("mono8", 0), ("mono16", 0), ("rgb8", 2), ("rgba8", 6)])
def test_png_without_metadata_is_accepted(registry: TypeRegistry, encoding: str, kind: int) -> None:
    pixels = random_pixels(encoding)
    convert = ENCODINGS[encoding].to_file
    data = cv2.imencode(".png", pixels if convert is None else cv2.cvtColor(pixels, convert))[1].tobytes()
    assert data[25] == kind  # colour type
    assert image_codec(registry).encode(image_wire(data)) == cdr_of(registry, pixels, encoding)


def test_other_programs_can_read_the_png(registry: TypeRegistry) -> None:
    pixels = random_pixels("rgb8")
    data = image_blob(image_codec(registry).decode(cdr_of(registry, pixels, "rgb8")))
    read = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert read is not None
    assert (read[..., ::-1] == pixels).all()
    image = pytest.importorskip("PIL.Image")
    assert (np.asarray(image.open(io.BytesIO(data))) == pixels).all()


def test_big_endian_image_becomes_little_endian(registry: TypeRegistry) -> None:
    pixels = random_pixels("mono16")
    swapped = cdr_of(registry, pixels.byteswap(), "mono16", is_bigendian=1)
    png = image_codec(registry)
    assert png.encode(image_wire(image_blob(png.decode(swapped)))) == cdr_of(registry, pixels, "mono16")


@pytest.mark.parametrize(("encoding", "luma"), [("yuv422", 1), ("yuv422_yuy2", 0)])
def test_yuv422_becomes_rgb8(registry: TypeRegistry, encoding: str, luma: int) -> None:
    pixels = np.full((4, 6, 2), 128, np.uint8)
    pixels[..., luma] = 180
    png = image_codec(registry)
    found = fields(registry, png.encode(image_wire(image_blob(png.decode(cdr_of(registry, pixels, encoding))))))
    assert (found["encoding"], found["step"]) == ("rgb8", 18)
    assert set(bytes(data_of(found))) <= set(range(186, 196))  # gray of luma 180 by BT.601: (180 - 16) * 1.164


@pytest.mark.parametrize("encoding", ["mono8", "rgb8", "bgr8"])
def test_jpeg_round_trip(registry: TypeRegistry, encoding: str) -> None:
    channels = ENCODINGS[encoding].channels
    ramp = np.linspace(0, 255, 32 * 32).reshape(32, 32).astype(np.uint8)
    pixels = ramp if channels == 1 else np.stack([ramp, 255 - ramp, ramp // 2], -1)
    jpeg = image_codec(registry, "jpeg")
    header = {"stamp": {"sec": 12, "nanosec": 34}, "frame_id": "cam"}
    data = image_blob(jpeg.decode(cdr_of(registry, pixels, encoding, header=header)))
    assert data.startswith(b"\xff\xd8\xff")
    assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) is not None
    found = fields(registry, jpeg.encode(image_wire(data)))
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
def test_encoding_that_the_format_cannot_hold_is_rejected(
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
def test_image_with_contradictory_fields_is_rejected(registry: TypeRegistry, wrong: dict[str, object]) -> None:
    with pytest.raises(ConversionError, match="image"):
        image_codec(registry).decode(cdr_of(registry, random_pixels("mono8"), "mono8", **wrong))


@pytest.mark.parametrize("image_format", ["png", "jpeg"])
def test_image_too_wide_for_the_format_is_rejected(registry: TypeRegistry, image_format: str) -> None:
    pixels = np.zeros((1, 70_000 if image_format == "jpeg" else 20_000_000), np.uint8)
    with pytest.raises(ConversionError, match="use format json"):
        image_codec(registry, image_format).decode(cdr_of(registry, pixels, "mono8"))


def test_json_format_round_trip(registry: TypeRegistry) -> None:
    cdr = cdr_of(registry, random_pixels("rgb8"), "rgb8")
    wire = image_codec(registry, "json").decode(cdr)
    assert not wire.is_blob
    assert not wire.blobs
    for image_format in ("png", "jpeg", "json"):  # the format is that of decoded images; encode() accepts any
        assert image_codec(registry, image_format).encode(wire) == cdr


def test_images_in_nested_messages_become_blobs(registry: TypeRegistry) -> None:
    own = TypeRegistry()
    own.add({"demo/msg/Rig": "string name\nsensor_msgs/Image left\nsensor_msgs/Image[] others\nuint8 end\n"})
    rig, plain = (image_codec(own, image_format, "demo/Rig") for image_format in ("png", "json"))
    one, two = (fields(registry, cdr_of(registry, random_pixels(name), name)) for name in ("rgb8", "mono8"))
    value = {"name": "a", "left": one, "others": [two, one], "end": 7}
    cdr = plain.encode(json_wire(json.dumps(value)))
    wire = rig.decode(cdr)
    found = json.loads(bytes(wire.raw))
    assert found.keys() == {"name", "left*", "others*", "end"}
    assert list(wire.blobs) == [found["left*"], *found["others*"]]
    assert rig.encode(wire) == plain.encode(wire) == cdr
    assert json.loads(bytes(plain.decode(cdr).raw)) == value
    with pytest.raises(ConversionError) as caught:
        rig.encode(msgspec.structs.replace(wire, blobs={**wire.blobs, found["others*"][1]: b"?"}))
    assert caught.value.field == "others*"


@pytest.mark.parametrize("raw", [b"5", b"", b'"', b'["x"]', b'"\xff"', b"[" * 100_000, b'"unknown"'])
def test_blob_message_without_valid_blob_id_is_rejected(registry: TypeRegistry, raw: bytes) -> None:
    with pytest.raises(ConversionError):
        image_codec(registry).encode(Wire(True, raw, {"x": b""}))


def test_image_may_be_plain_json(registry: TypeRegistry) -> None:
    assert round_trip(image_codec(registry, "json"), {"width": 3})["width"] == 3
