"""Metrics as text for Prometheus, and metrics of other processes that are not valid."""

from __future__ import annotations

import pytest

from rce.errors import InvalidRequest
from rce.process.exposition import prometheus_text
from rce.process.metrics import Family, Sample


def lines(*families: Family) -> list[str]:
    return prometheus_text(families).decode().splitlines()


def test_gauge() -> None:
    assert lines(Family("rce_links", "Links", "gauge", ["state"], [Sample(["up"], 2), Sample(["down"], 0.5)])) == [
        "# HELP rce_links Links",
        "# TYPE rce_links gauge",
        'rce_links{state="up"} 2.0',
        'rce_links{state="down"} 0.5',
    ]


def test_counter_ends_in_total() -> None:
    assert lines(Family("rce_x", "X", "counter", [], [Sample([], 3)]))[-1] == "rce_x_total 3.0"


def test_buckets_of_a_histogram_are_cumulative() -> None:
    family = Family("rce_y", "Y", "histogram", ["hop"], [Sample(["a"], 7.5, [2, 1, 4])], [0.1, 1.0])
    assert lines(family)[2:] == [
        'rce_y_bucket{hop="a",le="0.1"} 2.0',
        'rce_y_bucket{hop="a",le="1.0"} 3.0',
        'rce_y_bucket{hop="a",le="+Inf"} 7.0',
        'rce_y_count{hop="a"} 7.0',
        'rce_y_sum{hop="a"} 7.5',
    ]


def test_values_of_labels_are_escaped() -> None:
    assert lines(Family("x", "", "gauge", ["l"], [Sample(['a"b\\c\nd'], 1)]))[-1] == r'x{l="a\"b\\c\nd"} 1.0'


def test_no_families_are_no_text() -> None:
    assert prometheus_text([]) == b""


@pytest.mark.parametrize(
    "family",
    [
        Family("x{evil}", "", "gauge"),
        Family("", "", "gauge"),
        Family("x\n", "", "gauge"),
        Family("x", "", "gauge", ["not-valid"]),
        Family("é", "", "gauge"),
        Family("x", "", "gauge", ["a"], [Sample([], 1)]),
        Family("x", "", "gauge", [], [Sample(["a"], 1)]),
        Family("x", "", "histogram", [], [Sample([], 1, [1])], [0.1]),
        Family("x", "", "histogram", [], [Sample([], 1, [1, 2, 3])], [0.1]),
    ],
)
def test_invalid_metric_of_a_process_is_refused(family: Family) -> None:
    with pytest.raises(InvalidRequest, match="the process reported invalid metrics"):
        prometheus_text([family])
