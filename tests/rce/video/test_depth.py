from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.video.depth import FORMATS, HEAD, DepthDecoder, DepthEncoder, Format
from tests.support.pictures import depth


@pytest.mark.parametrize("format", FORMATS)
def test_depth_arrives_bit_for_bit(format: Format) -> None:
    encoder, decoder = DepthEncoder(format), DepthDecoder()
    for number in range(5):
        assert (decoder.decode(encoder.encode(depth(number))) == depth(number)).all()


@pytest.mark.parametrize("format", FORMATS)
def test_every_packet_is_decodable_by_itself(format: Format) -> None:
    encoder = DepthEncoder(format)
    packets = [encoder.encode(depth(number)) for number in range(3)]
    assert all(packet.key for packet in packets)
    assert (DepthDecoder().decode(packets[2]) == depth(2)).all()


@pytest.mark.parametrize("format", FORMATS)
def test_any_values_and_odd_sizes_survive(format: Format) -> None:
    encoder, decoder = DepthEncoder(format), DepthDecoder()
    for width, height in ((33, 21), (120, 90), (1, 1)):
        image = np.random.default_rng(width).integers(0, 65536, (height, width)).astype(np.uint16)
        assert (decoder.decode(encoder.encode(image)) == image).all()


def test_new_value_needs_no_announcement() -> None:
    encoder, decoder, image = DepthEncoder(), DepthDecoder(), depth(0)
    decoder.decode(encoder.encode(image))
    image[5, 5] = 64999
    assert (decoder.decode(encoder.encode(image)) == image).all()


def test_palette_is_smaller_than_plain_ffv1() -> None:
    image = depth(0, 320, 240)
    palette, plain = (len(DepthEncoder(format).encode(image).data) for format in ("palette", "ffv1"))  # type: ignore[arg-type]
    assert palette < plain < image.nbytes


@pytest.mark.parametrize("size", [0, HEAD.size - 1, HEAD.size, 100])
def test_cut_packet_is_refused(size: int) -> None:
    packet = DepthEncoder().encode(depth(0))
    with pytest.raises(InvalidRequest, match="depth"):
        DepthDecoder().decode(dataclasses.replace(packet, data=packet.data[:size]))


def test_damaged_packets_are_refused_or_give_an_image_but_nothing_else() -> None:
    generator, decoder, packet = np.random.default_rng(4), DepthDecoder(), DepthEncoder().encode(depth(0))
    refused = 0
    for _ in range(200):
        data = np.frombuffer(packet.data, np.uint8).copy()
        data[generator.integers(0, len(data), 8)] = generator.integers(0, 256, 8)
        try:
            decoder.decode(dataclasses.replace(packet, data=data.tobytes()))
        except InvalidRequest:
            refused += 1
    assert refused
    assert (decoder.decode(packet) == depth(0)).all()


def test_empty_image_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="0x0"):
        DepthEncoder().encode(np.empty((0, 0), np.uint16))
