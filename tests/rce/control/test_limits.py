"""Budget of calls of a user's environments."""

from __future__ import annotations

import pytest

from rce.control import limits
from rce.control.calls.joining import Hello
from rce.control.limits import BURST, CALLS_PER_CONNECTION, CALLS_PER_SECOND, Budget, Budgets


def test_burst_is_free_and_more_waits() -> None:
    now = 100.0
    budget = Budget(lambda: now)
    assert {budget.use(1) for _ in range(BURST)} == {0.0}
    assert budget.use(CALLS_PER_SECOND) == 1.0
    now += 1.0
    assert budget.use(0) == 0.0
    now += BURST / CALLS_PER_SECOND
    assert budget.use(BURST) == 0.0


def test_budget_grows_with_the_number_of_connections() -> None:
    now = 100.0
    budget = Budget(lambda: now)
    budget.connections = 200
    budget.use(BURST)
    assert budget.use(CALLS_PER_SECOND + CALLS_PER_CONNECTION * 200) == 1.0


def test_all_environments_of_a_user_join_at_once_but_none_again_and_again() -> None:
    budget = Budget(lambda: 100.0)
    assert {budget.join(f"ann/{number}") for number in range(10 * BURST)} == {0.0}
    waits = [budget.join("ann/0") for _ in range(BURST)]
    assert waits[0] == 0.0
    assert waits[-1] > 0.0


def test_environments_that_joined_are_forgotten_in_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MAX_JOINED", 3)
    budget = Budget(lambda: 100.0)
    for number in range(1000):
        budget.join(f"ann/{number}")
    assert list(budget._joined) == ["ann/997", "ann/998", "ann/999"]


def test_environments_of_a_user_share_a_budget() -> None:
    budgets = Budgets()
    brain, arm, other = (budgets.of(Hello("environment", name, "", "")) for name in ("ann/brain", "ann/arm", "bob/x"))
    assert brain is arm
    assert brain is not other
    assert budgets.of(Hello("robot", "west", "", "")) is None
