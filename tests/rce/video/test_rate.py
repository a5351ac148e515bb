from __future__ import annotations

from rce.video.rate import RATE_CONFIG, RateControl


def test_drop_lowers_the_rate_once_for_each_congestion() -> None:
    control = RateControl()
    assert control.report(0.0, dropped=True)
    assert control.rate == 300_000
    assert not control.report(0.5, dropped=True)
    assert control.report(1.1, dropped=True)
    assert control.rate == 180_000


def test_rate_grows_again_while_nothing_is_dropped() -> None:
    control = RateControl()
    control.report(0.0, dropped=True)
    changes = [second for second in range(1, 30) if control.report(second, dropped=False)]
    assert changes == [5, 10, 15]
    assert control.rate == RATE_CONFIG.highest


def test_rate_keeps_its_lowest_value() -> None:
    control = RateControl()
    for second in range(0, 60, 2):
        control.report(second, dropped=True)
    assert control.rate == RATE_CONFIG.lowest
