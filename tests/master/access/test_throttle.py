"""Throttle of wrong passwords by user name and by address."""

from __future__ import annotations

import pytest

from master.access import throttle as module
from master.access.throttle import FORGET_AFTER, FREE_BY_ADDRESS, FREE_BY_USER, MAX_WAIT, Throttle
from rce.errors import TooManyAttempts


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def throttle(clock: Clock) -> Throttle:
    return Throttle(clock)


def wait(throttle: Throttle, user: str, address: str) -> float:
    """Return the seconds that the error tells to wait."""
    try:
        throttle.check(user, address)
    except TooManyAttempts as error:
        return int(str(error.info.fields["retry_after"]))
    return 0


def guess(throttle: Throttle, times: int, user: str = "ann", address: str = "10.0.0.1") -> None:
    for _ in range(times):
        throttle.wrong(user, address)


def test_each_wrong_password_doubles_the_wait_up_to_a_maximum(throttle: Throttle, clock: Clock) -> None:
    guess(throttle, FREE_BY_USER - 1)
    assert wait(throttle, "ann", "10.0.0.1") == 0
    waits = []
    for _ in range(12):
        guess(throttle, 1)
        waits.append(wait(throttle, "ann", "10.0.0.9"))
        clock.now += waits[-1]
        assert wait(throttle, "ann", "10.0.0.9") == 0
    assert waits == [1, 2, 4, 8, 16, 32, 64, 128, 256, 512, MAX_WAIT, MAX_WAIT]
    assert wait(throttle, "bob", "10.0.0.9") == 0


def test_wrong_passwords_are_forgotten_after_a_while(throttle: Throttle, clock: Clock) -> None:
    guess(throttle, FREE_BY_USER + 3)
    clock.now = FORGET_AFTER + 1
    guess(throttle, FREE_BY_USER - 1)
    assert wait(throttle, "ann", "10.0.0.1") == 0


def test_address_that_tries_many_names_is_throttled(throttle: Throttle) -> None:
    for number in range(FREE_BY_ADDRESS):
        guess(throttle, 1, f"u{number}")
    assert wait(throttle, "another", "10.0.0.1") == 1
    assert wait(throttle, "another", "10.0.0.2") == 0


def test_known_address_is_not_locked_out_by_others(throttle: Throttle) -> None:
    throttle.right("ann", "10.0.0.7")
    guess(throttle, FREE_BY_USER + 5)
    assert wait(throttle, "ann", "10.0.0.1") > 0
    assert wait(throttle, "ann", "10.0.0.7") == 0
    guess(throttle, FREE_BY_USER, address="10.0.0.7")  # attempts there are limited, too
    assert wait(throttle, "ann", "10.0.0.7") == 1


def test_right_password_does_not_reset_counts(throttle: Throttle) -> None:
    for _ in range(FREE_BY_ADDRESS):
        guess(throttle, 1, "ann")
        throttle.right("mallory", "10.0.0.1")
    assert wait(throttle, "ann", "10.0.0.2") > 0
    assert wait(throttle, "mallory", "10.0.0.1") > 0


def test_loopback_is_not_counted_as_an_address(throttle: Throttle) -> None:
    for number in range(FREE_BY_ADDRESS + 5):
        guess(throttle, 1, f"u{number}", "127.0.0.1")
    assert wait(throttle, "ann", "127.0.0.1") == 0


def test_memory_is_bounded(throttle: Throttle, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_REMEMBERED", 10)
    for number in range(100):
        guess(throttle, 1, f"u{number}" * 1000, f"10.0.0.{number}")
        throttle.right(f"v{number}", f"10.0.1.{number}")
    assert len(throttle) <= 40
