"""Tests of medians, percentiles and ratios."""

from __future__ import annotations

from rce.bench.statistics import MIN_FOR_P99, Series, percentile, summary


def test_percentile_is_a_sample() -> None:
    assert percentile(range(1, 101), 99) == 99
    assert percentile(range(1, 1001), 99) == 990
    assert percentile([3.0], 99) == 3.0


def test_summary_has_a_tail_only_with_enough_samples() -> None:
    few, many = summary([1.0] * (MIN_FOR_P99 - 1), []), summary([1.0] * (MIN_FOR_P99 - 2) + [5.0, 7.0], [])
    assert few is not None
    assert few.p99 is None
    assert many is not None
    assert many.p99 == 5.0


def test_ratio_is_of_medians() -> None:
    found = summary([2.0, 4.0, 90.0], [1.0, 2.0, 3.0])
    assert found is not None
    assert (found.median, found.ratio) == (4.0, 2.0)
    alone = summary([2.0], [])
    assert alone is not None
    assert alone.ratio is None
    assert summary([], [1.0]) is None


def test_small_samples_are_up_to_10_kb() -> None:
    series = Series("s", "topic")
    for size in (10, 10_000, 10_001):
        series.add(size, float(size))
    assert series.small() == [10.0, 10_000.0]
