"""Counters and histograms, and their text for Prometheus."""

from __future__ import annotations

import asyncio

import pytest

from rce.process import metrics
from rce.process.exposition import prometheus_text
from rce.process.metrics import (
    Counter,
    Family,
    Observed,
    Sample,
    Timing,
    counter_family,
    gauge_family,
    merge_families,
    watch_loop,
)
from tests.support.hand_turned import HandTurnedLoop


@pytest.fixture(autouse=True)
def unregistered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the metrics of a test out of the process."""
    monkeypatch.setattr(metrics, "_registered", [])


def test_counters_count_by_their_labels() -> None:
    counter = Counter("rce_x", "What it is", "to", "code")
    counter.add("robot", "not_found")
    counter.add("robot", "not_found", by=4)
    counter.add("http", 'of "odd" words')
    assert prometheus_text([counter.family()]).decode().splitlines() == [
        "# HELP rce_x_total What it is",
        "# TYPE rce_x_total counter",
        'rce_x_total{code="not_found",to="robot"} 5.0',
        'rce_x_total{code="of \\"odd\\" words",to="http"} 1.0',
    ]


def test_counter_without_labels_begins_at_zero() -> None:
    assert prometheus_text([Counter("rce_x", "What it is").family()]).decode().splitlines()[-1] == "rce_x_total 0.0"


def test_observation_counts_in_the_first_bucket_that_takes_it() -> None:
    timing = Timing("rce_y_seconds", "How long", "hop", bounds=(0.1, 1.0))
    for seconds in (0.05, 0.1, 0.5, 7.0):
        timing.labels("there").observe(seconds)
    assert timing.labels("there").counts == [2, 1, 1]
    lines = prometheus_text([timing.family()]).decode().splitlines()[2:]
    assert lines == [
        'rce_y_seconds_bucket{hop="there",le="0.1"} 2.0',
        'rce_y_seconds_bucket{hop="there",le="1.0"} 3.0',
        'rce_y_seconds_bucket{hop="there",le="+Inf"} 4.0',
        'rce_y_seconds_count{hop="there"} 4.0',
        'rce_y_seconds_sum{hop="there"} 7.65',
    ]


def test_parts_are_distinguished_by_a_label() -> None:
    links = [gauge_family("rce_links", "Links", ["state"], {("up",): count}) for count in (1, 2)]
    other = counter_family("rce_links", "Links", ["kind"], {("tcp",): 3})
    timing = [Family("rce_x", "", "histogram", [], [Sample([], 1.0, [1, 2])], [bound]) for bound in (0.1, 0.2)]
    found = merge_families([links[0], timing[0]], "node", {"n1": [links[1], timing[1]], "n2": [other]})
    lines = [line for line in prometheus_text(found).decode().splitlines() if not line.startswith("#")]
    assert lines[:2] == ['rce_links{node="",state="up"} 1.0', 'rce_links{node="n1",state="up"} 2.0']
    assert [line.partition(" ")[0] for line in lines[2:]] == [
        'rce_x_bucket{le="0.1",node=""}',
        'rce_x_bucket{le="+Inf",node=""}',
        'rce_x_count{node=""}',
        'rce_x_sum{node=""}',
    ], "what another version tells in another form"


def test_lag_of_the_loop_is_its_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    lag = Observed((0.1, 1.0))
    monkeypatch.setattr(Timing, "labels", lambda self: lag)
    hand = HandTurnedLoop()
    task = hand.begin(watch_loop())
    hand.turn(1.0)
    hand.call_at(hand.time() + 0.9, lambda: setattr(hand, "_now", hand.time() + 0.6))  # something blocks the loop
    hand.turn(1.0)
    assert lag.counts == [1, 1, 0]
    task.cancel()
    hand.settle()
    hand.close()


async def test_tasks_of_the_loop_are_counted() -> None:
    def count() -> float:
        return next(each.samples[0].value for each in metrics.collect_families("x") if each.name == "rce_tasks")

    before = count()
    tasks = [asyncio.create_task(asyncio.sleep(60)) for _ in range(3)]
    assert count() == before + 3
    for task in tasks:
        task.cancel()


def test_process_without_a_loop_has_no_tasks() -> None:
    assert metrics._count_tasks() == 0
