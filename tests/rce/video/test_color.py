from __future__ import annotations

import dataclasses
import os

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.video.color import FORMATS, ColorConfig, ColorDecoder, ColorEncoder, Format
from tests.support.pictures import color, noise


@pytest.mark.parametrize("format", FORMATS)
def test_each_packet_is_an_image_at_once(format: Format) -> None:
    encoder, decoder = ColorEncoder(ColorConfig(format)), ColorDecoder(format)
    for number in range(6):
        packet = encoder.encode(color(number))
        image = decoder.decode(packet)
        assert (packet.number, packet.key) == (number, number == 0)
        assert image is not None
        assert np.abs(image.astype(int) - color(number)).mean() < 8


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="needs the scheduling calls of Linux")
@pytest.mark.parametrize("format", FORMATS)
def test_encoder_changes_the_scheduling_of_no_thread(format: Format) -> None:
    """As root, SVT-AV1 would take the highest real-time priority."""
    encoder, before = ColorEncoder(ColorConfig(format)), os.sched_getscheduler(0)
    encoder.encode(color(0))
    encoder.encode(color(1))
    assert {os.sched_getscheduler(int(thread)) for thread in os.listdir("/proc/self/task")} == {before}


@pytest.mark.parametrize("format", FORMATS)
def test_requested_key_frame_is_decodable_by_somebody_new(format: Format) -> None:
    encoder, late = ColorEncoder(ColorConfig(format)), ColorDecoder(format)
    encoder.encode(color(0))
    assert late.decode(encoder.encode(color(1))) is None
    assert late.needs_key
    encoder.request_key()
    packet = encoder.encode(color(2))
    assert packet.key
    assert late.decode(packet) is not None
    assert not late.needs_key


def test_after_a_drop_nothing_is_shown_until_a_key_frame() -> None:
    encoder, decoder = ColorEncoder(), ColorDecoder()
    packets = [encoder.encode(color(number)) for number in range(4)]
    encoder.request_key()
    packets.append(encoder.encode(color(4)))
    shown = [decoder.decode(packet) is not None for packet in packets if packet.number != 1]
    assert shown == [True, False, False, True]


@pytest.mark.parametrize("rate", [40_000, 160_000])
def test_rate_is_bounded_even_for_noise(rate: int) -> None:
    encoder = ColorEncoder(ColorConfig(rate=rate))
    sizes = [len(encoder.encode(noise(number, 160, 120)).data) for number in range(60)]
    assert sum(sizes[30:]) < 1.2 * rate


def test_lower_rate_takes_effect_with_a_key_frame() -> None:
    encoder = ColorEncoder(ColorConfig(rate=200_000))
    before = sum(len(encoder.encode(noise(number, 160, 120)).data) for number in range(30))
    encoder.set_rate(50_000)
    packets = [encoder.encode(noise(number, 160, 120)) for number in range(30)]
    assert packets[0].key
    assert sum(len(each.data) for each in packets) < before / 2


def test_image_of_another_size_begins_anew() -> None:
    encoder, decoder = ColorEncoder(), ColorDecoder()
    decoder.decode(encoder.encode(color(0)))
    packet = encoder.encode(color(1, 128, 80))
    image = decoder.decode(packet)
    assert packet.key
    assert image is not None
    assert image.shape == (80, 128, 3)


def test_image_with_an_odd_side_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="63x72"):
        ColorEncoder().encode(color(0, 63))


def test_size_that_the_format_does_not_support_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="av1 cannot encode images of 64x48"):
        ColorEncoder(ColorConfig("av1")).encode(color(0, 64, 48))


def test_damaged_packet_is_refused_and_a_key_frame_repairs() -> None:
    encoder, decoder = ColorEncoder(), ColorDecoder()
    packet = encoder.encode(color(0))
    with pytest.raises(InvalidRequest, match="h264"):
        decoder.decode(dataclasses.replace(packet, data=b"\xff" * 100))
    assert decoder.needs_key
    assert decoder.decode(packet) is not None
