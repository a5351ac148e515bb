"""Model of a line: delay, order, rate, queue, losses and outages."""

from __future__ import annotations

from random import Random

import pytest

from rce.bench.network.line import BURST, PROFILES, Line, Way

PACKET = 1250  # bytes: 10,000 bits


def line(delay: float = 0.1, jitter: float = 0.0, loss: float = 0.0, rate: float = 1e6, queue: float = 0.5) -> Line:
    return Line(Way(delay, jitter, loss, rate, queue), Random(1))


def test_packet_arrives_after_its_transmission_and_the_delay() -> None:
    assert line().arrival(5.0, PACKET) == pytest.approx(5.0 + 0.01 + 0.1)


def test_packets_wait_for_the_rate() -> None:
    slow = line()
    assert [slow.arrival(0.0, PACKET) for _ in range(3)] == pytest.approx([0.11, 0.12, 0.13])


def test_packet_is_dropped_when_the_queue_is_full() -> None:
    slow = line(queue=0.1)
    arrived = [slow.arrival(0.0, PACKET) is not None for _ in range(20)]
    assert arrived == [True] * 11 + [False] * 9
    assert slow.arrival(0.1, PACKET) is not None, "there is room again later"


def test_jitter_keeps_the_order() -> None:
    radio = line(jitter=0.09, rate=1e9)
    times = [radio.arrival(number / 1000, PACKET) for number in range(500)]
    found = [time for time in times if time is not None]
    assert found == sorted(found)
    delays = [time - number / 1000 for number, time in enumerate(found)]
    assert max(delays) > 0.15


def test_losses_come_in_bursts_at_the_given_rate() -> None:
    radio = line(loss=0.03, rate=1e12)
    lost = [radio.arrival(float(number), PACKET) is None for number in range(200_000)]
    assert sum(lost) / len(lost) == pytest.approx(0.03, rel=0.1)
    bursts = sum(now and not before for before, now in zip([False, *lost], lost, strict=False))
    assert sum(lost) / bursts == pytest.approx(BURST, rel=0.1)


def test_nothing_passes_during_an_outage() -> None:
    radio = line()
    radio.up = False
    assert radio.arrival(0.0, PACKET) is None
    radio.up = True
    assert radio.arrival(1.0, PACKET) is not None


def test_profiles_have_the_round_trips_of_their_names() -> None:
    assert {name: round(profile.round_trip, 3) for name, profile in PROFILES.items()} == {
        "wifi-edge": 0.02, "lte": 0.06, "satellite": 0.6, "tunnel": 0.06, "address-change": 0.06,
    }  # fmt: skip
