"""Rows and medians that `rce trace` prints."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import cast

import msgspec
import pytest

from rce.api.client import ServerEvent
from rce.api.views import HopView, MessageTrace
from rce.cli.commands.tracing import CLOCK_WARNING, medians, paths, trace
from rce.cli.session import ConsoleSession
from rce.control.calls.watching import Hop


def message(name: str, *hops: tuple[str, Hop, float], host: str = "h") -> MessageTrace:
    views = [HopView(interface, hop, time, host) for interface, hop, time in hops]
    return MessageTrace(name, "brain/out", views)


ONE = message(
    "m1",
    ("brain/out", "entered", 1.0),
    ("brain/out", "sent", 1.001),
    ("r1/in", "received", 1.003),
    ("r1/in", "delivered", 1.010),
)


def rounded(row: dict[str, float]) -> dict[str, int]:
    return {step: round(value) for step, value in row.items()}


def test_step_is_the_time_since_the_previous_hop() -> None:
    ((to, row),) = paths(ONE)
    assert to == "r1/in"
    assert rounded(row) == {"sent": 1000, "received": 2000, "delivered": 7000, "total": 10_000}


def test_message_to_two_interfaces_has_a_row_for_each_without_missing_steps() -> None:
    both = message(
        "m",
        ("brain/out", "entered", 1.0),
        ("brain/out", "sent", 1.1),
        ("r1/in", "received", 1.2),
        ("r2/in", "delivered", 1.5),
    )
    rows = {to: rounded(row) for to, row in paths(both)}
    assert rows == {
        "r1/in": {"sent": 100_000, "received": 100_000, "total": 200_000},
        "r2/in": {"sent": 100_000, "total": 500_000},
    }


def test_response_of_a_service_adds_the_steps_back() -> None:
    there = [("brain/out", "entered", 0.0), ("brain/out", "sent", 0.1), ("r1/in", "received", 0.2)]
    back = [("r1/in", "entered", 1.3), ("r1/in", "sent", 1.4), ("brain/out", "received", 1.5)]
    hops = [*there, ("r1/in", "delivered", 0.3), *back, ("brain/out", "delivered", 1.6)]
    ((_, row),) = paths(message("call", *hops))  # type: ignore[arg-type]  # hops are strings
    assert {step: round(value / 1e5) for step, value in row.items()} == {
        "sent": 1, "received": 1, "delivered": 1, "entered back": 10, "sent back": 1, "received back": 1,
        "delivered back": 1, "total": 16,
    }  # fmt: skip


def test_median_of_a_step_ignores_rows_without_it() -> None:
    assert medians([{"sent": 1, "total": 5}, {"sent": 3}, {"total": 7}]) == {"sent": 2, "total": 6}


class FakeApi:
    def __init__(self, *messages: MessageTrace) -> None:
        self.messages = messages

    def follow(self, *parts: str, **query: object) -> Iterator[ServerEvent]:
        assert parts == ("interfaces", "brain", "out", "trace")
        assert query["messages"] == 2
        yield from (ServerEvent("message", msgspec.json.encode(each).decode()) for each in self.messages)


def test_trace_prints_messages_medians_and_a_warning_about_clocks(
    capsys: pytest.CaptureFixture[str],
) -> None:
    session = cast(
        ConsoleSession, argparse.Namespace(api=FakeApi(ONE, message("m2", ("r1/in", "received", 2.0), host="other")))
    )
    trace(session, argparse.Namespace(interface="brain/out", count=2, of="", json=False))
    title, first, second, last, clocks = capsys.readouterr().out.splitlines()
    assert title.split()[:5] == ["MESSAGE", "TO", "SENT", "RECEIVED", "DELIVERED"]
    assert first.split() == ["m1", "r1/in", "1000", "2000", "7000", "-", "-", "-", "-", "10000"]
    assert second.split()[:3] == ["m2", "r1/in", "-"]
    assert last.split()[:4] == ["median", "of", "2", "1000"]
    assert clocks == CLOCK_WARNING
