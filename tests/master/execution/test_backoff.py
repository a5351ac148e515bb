"""Back-off: pauses that double with each failure in a row."""

from __future__ import annotations

from master.execution import backoff
from master.execution.backoff import Backoff
from tests.support.hand_turned import HandTurnedLoop


def test_pauses_double_up_to_the_maximum(hand: HandTurnedLoop) -> None:
    pauses = Backoff(1.0, 5.0, 10.0)
    assert hand.do(lambda: [pauses.after_failure("a") for _ in range(5)]) == [0.0, 1.0, 2.0, 4.0, 5.0]


def test_pauses_start_over_after_a_steady_time(hand: HandTurnedLoop) -> None:
    pauses = Backoff(1.0, 5.0, 10.0)
    hand.do(lambda: [pauses.after_failure("a") for _ in range(3)])
    hand.turn(2.0 + 10.1)
    assert hand.do(lambda: pauses.after_failure("a")) == 0.0


def test_keys_are_independent(hand: HandTurnedLoop) -> None:
    pauses = Backoff(1.0, 5.0, 10.0)
    assert hand.do(lambda: [pauses.after_failure(key) for key in "aab"]) == [0.0, 1.0, 0.0]


def test_old_failures_are_forgotten(hand: HandTurnedLoop) -> None:
    pauses = Backoff(1.0, 5.0, 10.0)
    hand.do(lambda: [pauses.after_failure(str(number)) for number in range(backoff.MAX_FAILURES + 1)])
    hand.turn(20.0)
    hand.do(lambda: pauses.after_failure("new"))
    assert len(pauses._failures) == 1
