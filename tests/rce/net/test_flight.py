"""Bytes in flight: what is held back, by the measurements of a line."""

from __future__ import annotations

import contextlib
import socket

import pytest

from rce.net.flight import (
    LEAST_PART,
    MOST_PART,
    QUEUE,
    STALLED,
    STALLED_TRIPS,
    UNKNOWN,
    WINDOW,
    Flight,
    Sample,
    flight_of,
)

MANY = 10**9  # bytes, after which the line is measured again


class Line:
    """Line whose measurements are set by the test."""

    def __init__(self, in_flight: int, round_trip: float, rate: float) -> None:
        self.sample: Sample | None = Sample(in_flight, 0, round_trip, rate)
        self.now = 0.0
        self.flight = Flight(lambda: self.sample, lambda: self.now)

    def set(self, **changes: float) -> None:
        assert self.sample is not None
        self.sample = self.sample._replace(**changes)


def test_more_may_be_written_until_the_line_carries_a_round_trip_and_a_queue() -> None:
    line = Line(0, round_trip=0.05, rate=1_000_000)
    limit = int(1_000_000 * (0.05 + QUEUE))
    line.set(in_flight=limit - 1)
    assert line.flight.wait(MANY) == 0
    line.set(in_flight=limit)
    assert line.flight.wait(MANY) > 0


def test_greatest_rate_of_the_last_seconds_counts() -> None:
    line = Line(0, round_trip=0.05, rate=1_000_000)
    line.flight.wait(MANY)
    line.set(in_flight=50_000, rate=10_000)
    line.now = WINDOW
    assert line.flight.wait(MANY) == 0
    line.now = 2 * WINDOW
    assert line.flight.wait(MANY) > 0


def test_no_more_than_a_part_waits_in_the_kernel() -> None:
    line = Line(0, round_trip=0.05, rate=2_000_000)
    line.set(unsent=19_999)
    assert line.flight.wait(MANY) == 0
    line.set(unsent=20_000)
    assert line.flight.wait(MANY) > 0


def test_line_of_unknown_rate_gets_some_bytes() -> None:
    line = Line(UNKNOWN - 1, 0.0, 0)
    assert line.flight.wait(MANY) == 0
    line.set(in_flight=UNKNOWN)
    assert line.flight.wait(MANY) > 0


@pytest.mark.parametrize(
    ("rate", "part"), [(0, MOST_PART), (100_000, LEAST_PART), (2_000_000, 20_000), (1e9, MOST_PART)]
)
def test_parts_take_about_10_ms_of_the_line(rate: float, part: int) -> None:
    line = Line(0, 0.05, rate)
    line.flight.wait(MANY)
    assert line.flight.part == part


def test_nothing_is_held_back_without_measurements() -> None:
    line = Line(10**9, 0.05, 1000)
    line.sample = None
    assert line.flight.wait(MANY) == 0
    assert line.flight.part == MOST_PART


def test_connection_within_the_machine_is_not_held_back() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()) as client:
        client.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                client.send(bytes(65536))
        assert flight_of(client).wait() == 0


def test_other_sockets_are_not_held_back() -> None:
    assert flight_of(None).wait() == 0


def test_line_on_which_nothing_is_acknowledged_is_stalled() -> None:
    line = Line(1000, round_trip=0.1, rate=1e6)
    line.set(outstanding=True, acknowledged=5)
    limit = STALLED + STALLED_TRIPS * 0.1
    assert not line.flight.stalled()
    line.now = limit
    assert not line.flight.stalled()
    line.now = limit + 0.1
    assert line.flight.stalled()
    line.set(acknowledged=6)
    assert not line.flight.stalled()


def test_idle_line_is_not_stalled() -> None:
    line = Line(0, round_trip=0.1, rate=1e6)
    line.set(acknowledged=5)
    for _ in range(5):
        line.now += 100
        assert not line.flight.stalled()
    line.set(outstanding=True)
    assert not line.flight.stalled(), "what was sent just now is not late"


def test_small_messages_are_written_without_a_measurement_for_each() -> None:
    line = Line(0, 0.05, 1_000_000)
    assert line.flight.wait(1000) == 0
    line.set(in_flight=10**6)
    assert line.flight.wait(LEAST_PART - 1) == 0
    assert line.flight.wait(MOST_PART) > 0
    line.set(in_flight=0)
    assert line.flight.wait() == 0, "measured again while there is no room"
