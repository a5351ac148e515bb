"""Encoders and decoders of images by the name of a codec."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("av", reason="needs PyAV: pip install '.[video]'")

from rce.codecs.images import ImageDecoder, ImageEncoder, as_rgb
from rce.codecs.packed import Header
from rce.errors import ConversionError

GREY = np.tile(np.arange(64, dtype=np.uint8), (48, 1))


def test_depth_is_lossless_and_its_packets_need_no_others() -> None:
    depth = GREY.astype(np.uint16) * 50
    encoder = ImageEncoder("palette")
    packets = [encoder.encode(depth, "16UC1") for _ in range(3)]
    found = ImageDecoder("palette").decode(*packets[2])
    assert found is not None
    assert np.array_equal(found, depth)
    encoder.request_key()
    encoder.set_bitrate(1)


def test_video_begins_with_a_key_frame_and_again_when_it_is_requested() -> None:
    encoder, decoder = ImageEncoder("h264", 100_000), ImageDecoder("h264")
    heads = []
    for number in range(4):
        if number == 2:
            encoder.request_key()
        head, data = encoder.encode(GREY, "mono8", Header(frame_id="cam"))
        heads.append(head)
        assert decoder.decode(head, data) is not None
    assert [head.key for head in heads] == [True, False, True, False]
    assert (heads[0].header.frame_id, heads[0].width, heads[0].encoding) == ("cam", 64, "rgb8")
    encoder.set_bitrate(50_000)
    assert encoder.encode(GREY, "mono8")[0].key
    assert decoder.decode(*encoder.encode(GREY, "mono8")) is None, "it misses a packet"


def test_wrong_images_and_packets_are_refused() -> None:
    with pytest.raises(ConversionError, match="sides must be even"):
        ImageEncoder("h264").encode(GREY[:, :63], "mono8")
    with pytest.raises(ConversionError, match="takes images in 16UC1"):
        ImageEncoder("ffv1").encode(GREY, "mono8")
    head, data = ImageEncoder("png").encode(GREY.astype(np.uint16), "mono16")
    with pytest.raises(ConversionError, match="cut off"):
        ImageDecoder("png").decode(head, data[:9])


def test_colours_come_in_the_order_red_green_blue() -> None:
    image = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)
    assert np.array_equal(as_rgb(image, "bgra8"), image[:, :, [2, 1, 0]])
    assert np.array_equal(as_rgb(image, "rgba8"), image[:, :, :3])
