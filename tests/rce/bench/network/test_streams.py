"""Messages of the benchmark of bad networks."""

from __future__ import annotations

import time

from rce.bench.network.streams import STREAMS, Arrivals, cdr, sent_at, text


def test_message_carries_its_time_and_has_its_size() -> None:
    before = time.monotonic()
    assert len(cdr(1000)) == 1000 + 9
    assert len(text(1000)) == 1000
    assert before - 0.001 <= sent_at(text(100)) <= time.monotonic()


def test_arrivals_keep_the_time_of_each_message() -> None:
    arrivals, before = Arrivals(), time.monotonic()
    arrivals.add_cdr(cdr(50))
    ((sent, arrived),) = arrivals.times
    assert before - 0.001 <= sent <= arrived + 0.001


def test_streams_have_names_of_their_own() -> None:
    assert len({stream.name for stream in STREAMS}) == len(STREAMS)
