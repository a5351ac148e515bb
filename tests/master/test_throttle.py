"""Wrong passwords make the next tries wait, for a name and for an address, whether the name is a user's or not."""

from __future__ import annotations

import pytest

from master import throttle as module
from master.throttle import FORGET, FREE_OF_ADDRESS, FREE_OF_USER, LONGEST, Throttle, network
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
    """Seconds that are said."""
    try:
        throttle.check(user, address)
    except TooManyAttempts as error:
        return int(str(error.info.fields["retry_after"]))
    return 0


def guess(throttle: Throttle, times: int, user: str = "ann", address: str = "10.0.0.1") -> None:
    for _ in range(times):
        throttle.wrong(user, address)


def test_each_wrong_one_doubles_the_wait_up_to_the_longest(throttle: Throttle, clock: Clock) -> None:
    guess(throttle, FREE_OF_USER - 1)
    assert wait(throttle, "ann", "10.0.0.1") == 0
    waits = []
    for _ in range(12):
        guess(throttle, 1)
        waits.append(wait(throttle, "ann", "10.0.0.9"))
        clock.now += waits[-1]
        assert wait(throttle, "ann", "10.0.0.9") == 0
    assert waits == [1, 2, 4, 8, 16, 32, 64, 128, 256, 512, LONGEST, LONGEST]
    assert wait(throttle, "bob", "10.0.0.9") == 0


def test_it_is_forgotten_after_a_while(throttle: Throttle, clock: Clock) -> None:
    guess(throttle, FREE_OF_USER + 3)
    clock.now = FORGET + 1
    guess(throttle, FREE_OF_USER - 1)
    assert wait(throttle, "ann", "10.0.0.1") == 0


def test_an_address_that_tries_many_names(throttle: Throttle) -> None:
    for number in range(FREE_OF_ADDRESS):
        guess(throttle, 1, f"u{number}")
    assert wait(throttle, "another", "10.0.0.1") == 1
    assert wait(throttle, "another", "10.0.0.2") == 0


def test_who_has_been_there_before_is_not_kept_out_by_others(throttle: Throttle) -> None:
    throttle.right("ann", "10.0.0.7")
    guess(throttle, FREE_OF_USER + 5)
    assert wait(throttle, "ann", "10.0.0.1") > 0
    assert wait(throttle, "ann", "10.0.0.7") == 0
    guess(throttle, FREE_OF_USER, address="10.0.0.7")  # but nobody may guess there for ever
    assert wait(throttle, "ann", "10.0.0.7") == 1


def test_a_right_one_buys_no_guesses(throttle: Throttle) -> None:
    for _ in range(FREE_OF_ADDRESS):
        guess(throttle, 1, "ann")
        throttle.right("mallory", "10.0.0.1")
    assert wait(throttle, "ann", "10.0.0.2") > 0
    assert wait(throttle, "mallory", "10.0.0.1") > 0


def test_this_machine_may_be_a_proxy_and_is_no_address(throttle: Throttle) -> None:
    for number in range(FREE_OF_ADDRESS + 5):
        guess(throttle, 1, f"u{number}", "127.0.0.1")
    assert wait(throttle, "ann", "127.0.0.1") == 0


@pytest.mark.parametrize(
    ("address", "counts_as"),
    [
        ("10.1.2.3", "10.1.2.3"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("::ffff:10.1.2.3", "10.1.2.3"),
        ("fe80::1%eth0", "fe80::/64"),
        *((own, "") for own in ("127.0.0.1", "::1", "::ffff:127.0.0.1", "", "unix")),
    ],
)
def test_what_counts_as_one_address(address: str, counts_as: str) -> None:
    assert network(address) == counts_as


def test_memory_is_bounded(throttle: Throttle, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST", 10)
    for number in range(100):
        guess(throttle, 1, f"u{number}" * 1000, f"10.0.0.{number}")
        throttle.right(f"v{number}", f"10.0.1.{number}")
    assert len(throttle) <= 40
