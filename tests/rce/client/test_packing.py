"""Images and clouds of interfaces with a codec, from arrays to arrays."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("av", reason="needs PyAV: pip install '.[video]'")

from rce.client import packing
from rce.client.packing import Packer, Unpacker
from rce.errors import ConversionError, InvalidRequest, RceError
from tests.support.fake_platform import FakePlatform

IMAGE, CLOUD = "sensor_msgs/Image", "sensor_msgs/PointCloud2"
RGB = np.tile(np.arange(64, dtype=np.uint8), (48, 3)).reshape(48, 64, 3)
DEPTH = (np.arange(48 * 64).reshape(48, 64) % 300).astype(np.uint16)
KIND = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")])


def test_image_comes_out_with_its_header() -> None:
    packer, unpacker = Packer("h264", IMAGE), Unpacker("h264", IMAGE)
    for frame_id in ("", "cam"):
        got = unpacker.unpack(packer.pack({"header": {"frame_id": frame_id}, "image": RGB, "encoding": "rgb8"}))
        assert got is not None
        assert np.abs(got["image"].astype(int) - RGB).mean() < 6
        assert got["header"]["frame_id"] == frame_id


def test_depth_comes_out_bit_for_bit() -> None:
    got = Unpacker("palette", IMAGE).unpack(Packer("palette", IMAGE).pack(DEPTH))
    assert got is not None
    assert np.array_equal(got["image"], DEPTH)
    assert got["encoding"] == "16UC1"


def test_cloud_comes_out_as_a_structured_array() -> None:
    points = np.zeros((2, 3), KIND)
    points["x"] = np.arange(6).reshape(2, 3)
    value = {"points": points.reshape(-1), "height": 2, "width": 3, "header": {"frame_id": "lidar"}}
    got = Unpacker("quantised", CLOUD).unpack(Packer("quantised", CLOUD).pack(value))
    assert got is not None
    assert (got["height"], got["width"], got["header"]["frame_id"]) == (2, 3, "lidar")
    assert np.allclose(got["points"]["x"][:, 0], np.arange(6), atol=1e-3)


def test_packet_after_a_drop_is_a_key_frame() -> None:
    packer, unpacker = Packer("h264", IMAGE), Unpacker("h264", IMAGE)
    keys = [packer.pack(RGB, dropped)["key"] for dropped in (0, 0, 1, 1)]
    assert keys == [True, False, True, False]
    packer.request_key()
    packets = [packer.pack(RGB) for _ in range(3)]
    assert unpacker.unpack(packets[1]) is None, "video waits for a key frame"
    assert unpacker.unpack(packets[0]) is not None


def test_packets_pass_where_the_extra_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    packet = Packer("h264", IMAGE).pack(RGB)
    monkeypatch.setattr(packing, "can_unpack", lambda _: False)
    assert Unpacker("h264", IMAGE).unpack(packet) == packet
    assert Packer("h264", IMAGE).pack(packet) == packet
    with pytest.raises(InvalidRequest, match="needs av"):
        Packer("h264", IMAGE).pack(RGB)


def test_values_without_an_array_are_refused() -> None:
    with pytest.raises(InvalidRequest, match="'image': array"):
        Packer("h264", IMAGE).pack({"header": {}})
    with pytest.raises(InvalidRequest, match="structured array"):
        Packer("quantised", CLOUD).pack(RGB)
    with pytest.raises(ConversionError, match="takes images in 16UC1"):
        Packer("ffv1", IMAGE).pack(RGB)


async def test_robot_publishes_and_receives_arrays() -> None:
    async with FakePlatform() as platform, platform.robot() as robot:
        there = await robot.publisher("out", IMAGE, codec="h264")
        back = await robot.subscriber("in", IMAGE, codec="h264")
        await robot.connect("a/out", "a/in")
        assert platform.interfaces["a/in"]["codec"] == "h264"
        for _ in range(3):
            await there.publish(RGB)
            got = await back.get(30)
            assert np.abs(got["image"].astype(int) - RGB).mean() < 6


async def test_platform_that_misses_a_packet_gets_a_key_frame() -> None:
    async with FakePlatform() as platform, platform.robot() as robot:
        there = await robot.publisher("out", IMAGE, codec="h264")
        back = await robot.subscriber("in", IMAGE)
        await robot.connect("a/out", "a/in")
        keys = []
        for number in range(4):
            if number == 2:
                missing = ConversionError("video waits for a key frame", field="key").with_fields(
                    iTag="out", msgID="nil"
                )
                robot._dispatcher.error_received(missing)
            await there.publish(RGB)
            keys.append((await back.get(30))["key"])
        assert keys == [True, False, True, False]


async def test_stored_messages_have_no_codec() -> None:
    async with FakePlatform() as platform, platform.robot() as robot:
        with pytest.raises(RceError, match="has no codec"):
            await robot.publisher("out", IMAGE, codec="h264", offline="store")
