"""Texts that `rce topic` prints."""

from __future__ import annotations

from typing import Any

import pytest

from rce.cli.lazy.topics import bandwidth_text, rate_text, shorten, waiting_text


def test_rate_of_arrivals() -> None:
    lines = rate_text([0.0, 0.1, 0.3]).splitlines()
    assert lines == ["average rate: 6.667", "\tmin: 0.100s max: 0.200s std dev: 0.05000s window: 2"]


def test_one_arrival_has_no_rate() -> None:
    assert rate_text([1.0]) == "one message so far"


def test_bandwidth_of_messages() -> None:
    lines = bandwidth_text([(0.0, 1024), (1.0, 3072)], now=2.0).splitlines()
    assert lines == ["2 KiB/s from 2 messages", "\tMessage size mean: 2 KiB min: 1 KiB max: 3 KiB"]


def test_topic_without_subscribers_is_answered_with_the_nearest_that_has_some() -> None:
    topics = {"/cmd_val": 0, "/cmd_vel": 1, "/scan": 2}
    assert waiting_text("/cmd_val", topics) == "waiting for a subscriber of /cmd_val; did you mean /cmd_vel?"
    assert waiting_text("/goal", topics) == "waiting for a subscriber of /goal"


@pytest.mark.parametrize(
    ("value", "options", "expected"),
    [
        ({"a": [1, 2]}, {}, {"a": [1, 2]}),
        ([1] * 129, {}, [1] * 128 + ["..."]),
        ("x" * 129, {}, "x" * 128 + "..."),
        ({"a": [1] * 129}, {"full": True}, {"a": [1] * 129}),
        ({"a": [1, 2]}, {"no_arrays": True}, {"a": "<array of 2>"}),
        ({"data": b"123"}, {}, {"data": "<3 bytes>"}),
    ],
)
def test_long_arrays_and_strings_are_shortened(value: Any, options: dict[str, bool], expected: Any) -> None:
    assert shorten(value, **options) == expected
