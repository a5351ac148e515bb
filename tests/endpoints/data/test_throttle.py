"""Token bucket of received bytes."""

import pytest

from endpoints.data.throttle import MIN_BURST, Throttle


def test_burst_passes_at_once_and_the_rest_waits() -> None:
    now = 0.0
    throttle = Throttle(1_000_000, lambda: now)
    assert throttle.consume(100_000) == 0
    assert throttle.consume(500_000) == 0.5
    now = 0.5
    assert throttle.consume(0) == 0


def test_unused_rate_is_limited_to_one_burst() -> None:
    now = 0.0
    throttle = Throttle(1_000_000, lambda: now)
    now = 100
    assert throttle.consume(100_000) == 0
    assert throttle.consume(1_000) == pytest.approx(0.001)


def test_low_rate_has_minimum_burst() -> None:
    assert Throttle(1, lambda: 0.0).consume(MIN_BURST) == 0
