"""Comparison of the model with what is there."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import pytest

from rce.bench.chaos import audit
from rce.bench.chaos.audit import Found, differences, settle
from rce.bench.chaos.model import Fact, connection
from rce.bench.chaos.violations import Violation
from rce.errors import Unavailable

EXPECTED: set[Fact] = {("environment", "e"), ("node", "e", "n"), ("interface", "e", "i"), connection("r/i", "e/i")}


def found(**changes: Any) -> Found:
    """Return what agrees with EXPECTED, with changes."""
    agreeing: dict[str, Any] = {
        "facts": set(EXPECTED),
        "unsettled": [],
        "endpoints": Counter(["e"]),
        "nodes": Counter([("e", "n")]),
        "directories": Counter(["e"]),
        "trash": 0,
    }
    return Found(**agreeing | changes)


def test_what_agrees_has_no_differences() -> None:
    assert differences(EXPECTED, found()) == []


@pytest.mark.parametrize(
    ("changes", "difference"),
    [
        ({"facts": EXPECTED - {("node", "e", "n")}}, "missing: node e n"),
        ({"facts": EXPECTED | {("node", "e", "more")}}, "not asked for: node e more"),
        ({"unsettled": ["environment e is starting"]}, "environment e is starting"),
        ({"endpoints": Counter(["e", "e"])}, "2 processes of environment e instead of 1"),
        ({"endpoints": Counter(["e", "gone"])}, "1 processes of environment gone instead of 0"),
        ({"nodes": Counter[Any]()}, "0 processes of node e/n instead of 1"),
        ({"directories": Counter(["e", "e"])}, "2 directories of environment e instead of 1"),
        ({"trash": 3}, "3 directories in the trash"),
    ],
)
def test_difference_is_described(changes: dict[str, Any], difference: str) -> None:
    assert differences(EXPECTED, found(**changes)) == [difference]


@dataclass
class Looks:
    """Sequence of the states that the platform shows."""

    results: list[Found | Exception]

    def __call__(self) -> Found:
        result = self.results.pop(0) if len(self.results) > 1 else self.results[0]
        if isinstance(result, Exception):
            raise result
        return result


async def settled(monkeypatch: pytest.MonkeyPatch, *results: Found | Exception) -> float:
    monkeypatch.setattr(audit, "POLL_INTERVAL", 0)
    return await settle(EXPECTED, Looks(list(results)))


async def test_platform_may_take_a_while_to_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    assert await settled(monkeypatch, Unavailable("away"), found(trash=1), found()) > 0


async def test_platform_that_does_not_agree_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(audit, "SETTLE_TIMEOUT", 0)
    with pytest.raises(Violation, match=r"without faults:\n1 directories in the trash"):
        await settled(monkeypatch, found(trash=1))
