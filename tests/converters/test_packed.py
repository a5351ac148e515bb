"""Packets of images and clouds, from CDR and back."""

from __future__ import annotations

import base64
import json
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from converters import TypeRegistry, Wire
from converters.packed import KEY_FIELD, PackedCodec
from rce.errors import ConversionError
from rce.protocol.names import parse_type

pytest.importorskip("av", reason="needs PyAV: pip install '.[video]'")

REGISTRY = TypeRegistry()
HEADER = {"stamp": {"sec": 7, "nanosec": 8}, "frame_id": "cam"}
DEPTH = (np.arange(48 * 64).reshape(48, 64) % 300).astype(np.uint16)
RGB = np.stack([np.tile(np.arange(64, dtype=np.uint8) * 3, (48, 1))] * 3, axis=2)


def codec(type: str, name: str, **options: Any) -> PackedCodec:
    plain = REGISTRY.message(parse_type(type), "json")
    return PackedCodec(plain, msgspec.structs.replace(plain.recipe, codec=name, **options))


def cdr(type: str, value: dict[str, Any]) -> bytes:
    return REGISTRY.message(parse_type(type), "json").encode(Wire(False, json.dumps(value).encode(), {}))


def message(type: str, data: bytes) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(bytes(REGISTRY.message(parse_type(type), "json").decode(data).raw))
    return found


def image(pixels: NDArray[Any], encoding: str) -> bytes:
    step = pixels.nbytes // pixels.shape[0]
    sizes = {"height": pixels.shape[0], "width": pixels.shape[1], "step": step}
    data = base64.b64encode(pixels.tobytes()).decode()
    return cdr("sensor_msgs/Image", {"header": HEADER, "encoding": encoding, "data": data, **sizes})


def cloud(points: int = 50) -> bytes:
    values = np.random.default_rng(0).normal(size=(points, 4)).astype(np.float32)
    fields = [{"name": name, "offset": 4 * n, "datatype": 7, "count": 1} for n, name in enumerate(["x", "y", "z", "i"])]
    data = base64.b64encode(values.tobytes()).decode()
    sizes = {"height": 1, "width": points, "point_step": 16, "row_step": 16 * points}
    return cdr("sensor_msgs/PointCloud2", {"header": HEADER, "fields": fields, "data": data, **sizes})


@pytest.mark.parametrize("name", ["palette", "ffv1", "png"])
@pytest.mark.parametrize("encoding", ["16UC1", "mono16"])
def test_depth_comes_out_bit_for_bit(name: str, encoding: str) -> None:
    sent = image(DEPTH, encoding)
    packet = codec("sensor_msgs/Image", name).decode(sent)
    assert codec("sensor_msgs/Image", name).encode(packet) == sent


@pytest.mark.parametrize("name", ["h264", "vp9"])
@pytest.mark.parametrize(("encoding", "pixels"), [("rgb8", RGB), ("bgr8", RGB[:, :, ::-1]), ("mono8", RGB[:, :, 0])])
def test_video_comes_out_as_rgb_with_its_header(name: str, encoding: str, pixels: NDArray[Any]) -> None:
    sender, receiver = (codec("sensor_msgs/Image", name, stream="s") for _ in range(2))
    packet = sender.decode(image(np.ascontiguousarray(pixels), encoding))
    head = json.loads(bytes(packet.raw))
    assert (head["key"], head["number"], head["header"], head["width"]) == (True, 0, HEADER, 64)
    got = message("sensor_msgs/Image", receiver.encode(packet))
    assert (got["encoding"], got["header"], got["height"], got["step"]) == ("rgb8", HEADER, 48, 192)
    data = np.frombuffer(base64.b64decode(got["data"]), np.uint8).reshape(48, 64, 3)
    assert np.abs(data.astype(int) - RGB).mean() < 6


def test_video_that_misses_a_packet_asks_for_a_key_frame() -> None:
    sender, receiver = (codec("sensor_msgs/Image", "h264", stream="s") for _ in range(2))
    packets = [sender.decode(image(RGB, "rgb8")) for _ in range(3)]
    receiver.encode(packets[0])
    with pytest.raises(ConversionError, match="waits for a key frame") as raised:
        receiver.encode(packets[2])
    assert raised.value.info.field == KEY_FIELD
    sender.request_key()
    assert receiver.encode(sender.decode(image(RGB, "rgb8")))


@pytest.mark.parametrize("name", ["quantised", "draco"])
def test_cloud_comes_out_with_its_layout(name: str) -> None:
    if name == "draco":
        pytest.importorskip("DracoPy", reason="needs DracoPy: pip install '.[draco]'")
    sent = message("sensor_msgs/PointCloud2", cloud())
    packed = codec("sensor_msgs/PointCloud2", name)
    got = message("sensor_msgs/PointCloud2", packed.encode(packed.decode(cloud())))
    points, before = (np.frombuffer(base64.b64decode(m["data"]), np.float32).reshape(-1, 4) for m in (got, sent))
    order = [np.argsort(each[:, 0]) for each in (points, before)]
    assert np.abs(points[order[0]] - before[order[1]]).max() < 1e-3
    assert {**got, "data": 0, "is_dense": 0} == {**sent, "data": 0, "is_dense": 0}


def test_packets_that_do_not_fit_are_refused() -> None:
    depth = codec("sensor_msgs/Image", "png")
    packet = depth.decode(image(DEPTH, "16UC1"))
    with pytest.raises(ConversionError, match="the packet is png, the interface ffv1"):
        codec("sensor_msgs/Image", "ffv1").encode(packet)
    for wire in (Wire(False, b"{}", {}), Wire(False, b"[]", {}), Wire(False, packet.raw, {}), Wire(False, b"\xff", {})):
        with pytest.raises(ConversionError, match="no head, or no blob"):
            depth.encode(wire)
    with pytest.raises(ConversionError, match="takes images in 16UC1 or mono16"):
        depth.decode(image(RGB, "rgb8"))
    with pytest.raises(ConversionError, match="use a codec for depth"):
        codec("sensor_msgs/Image", "h264").decode(image(DEPTH, "16UC1"))
    assert not depth.encodes_fast(packet)
    assert not depth.decodes_fast(b"")


def test_video_stays_packed_where_its_type_is_video() -> None:
    sender = codec("sensor_msgs/Image", "h264", stream="s")
    packets = [sender.decode(image(RGB, "rgb8")) for _ in range(2)]
    (data,) = packets[1].blobs.values()
    got = message("foxglove_msgs/CompressedVideo", codec("foxglove_msgs/CompressedVideo", "h264").encode(packets[1]))
    assert (got["timestamp"], got["frame_id"], got["format"]) == (HEADER["stamp"], "cam", "h264")
    assert base64.b64decode(got["data"]) == data
    type_name = "ffmpeg_image_transport_msgs/FFMPEGPacket"
    got = message(type_name, codec(type_name, "h264").encode(packets[1]))
    assert (got["header"], got["encoding"], got["pts"], got["flags"]) == (HEADER, "h264", 1, 0)
    with pytest.raises(ConversionError, match="video already"):
        codec(type_name, "h264").decode(cdr(type_name, {}))
