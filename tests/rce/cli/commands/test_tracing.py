"""Rows and medians that `rce trace` prints."""

from __future__ import annotations

import msgspec
import pytest

from rce.api.views import HopView, MessageTrace
from rce.cli.commands.tracing import CLOCK_WARNING, medians, paths
from rce.control.calls.watching import Hop
from tests.support.console import Console, Request, open_terminal

Hops = list[tuple[str, Hop, float]]


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
    there: Hops = [
        ("brain/out", "entered", 0.0),
        ("brain/out", "sent", 0.1),
        ("r1/in", "received", 0.2),
    ]
    back: Hops = [
        ("r1/in", "entered", 1.3),
        ("r1/in", "sent", 1.4),
        ("brain/out", "received", 1.5),
    ]
    hops: Hops = [*there, ("r1/in", "delivered", 0.3), *back, ("brain/out", "delivered", 1.6)]
    ((_, row),) = paths(message("call", *hops))
    assert {step: round(value / 1e5) for step, value in row.items()} == {
        "sent": 1, "received": 1, "delivered": 1, "entered back": 10, "sent back": 1, "received back": 1,
        "delivered back": 1, "total": 16,
    }  # fmt: skip


def test_median_of_a_step_ignores_rows_without_it() -> None:
    assert medians([{"sent": 1, "total": 5}, {"sent": 3}, {"total": 7}]) == {"sent": 2, "total": 6}


def test_trace_prints_messages_medians_and_a_warning_about_clocks(capsys: pytest.CaptureFixture[str]) -> None:
    console = Console([ONE, message("m2", ("r1/in", "received", 2.0), host="other")])
    assert console.request("trace brain/out -n 2") == Request(
        "FOLLOW interfaces/brain/out/trace", {"follow": True, "messages": 2}
    )
    title, first, second, last, clocks = capsys.readouterr().out.splitlines()
    assert title.split()[:5] == ["MESSAGE", "TO", "SENT", "RECEIVED", "DELIVERED"]
    assert first.split() == ["m1", "r1/in", "1000", "2000", "7000", "-", "-", "-", "-", "10000"]
    assert second.split()[:3] == ["m2", "r1/in", "-"]
    assert last.split()[:4] == ["median", "of", "2", "1000"]
    assert clocks == CLOCK_WARNING


def test_interface_without_its_endpoint_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert Console([]).run("trace nope") != 0
    assert "interface 'nope' is not of the form endpointTag/interfaceTag" in capsys.readouterr().err


def test_trace_in_json_has_a_line_for_each_message(capsys: pytest.CaptureFixture[str]) -> None:
    Console([ONE, ONE]).request("trace brain/out --json")
    lines = capsys.readouterr().out.splitlines()
    assert [msgspec.json.decode(line, type=MessageTrace) for line in lines] == [ONE, ONE]


def test_steps_back_are_on_a_second_line_of_a_narrow_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = open_terminal(monkeypatch, 80)
    back = message("m2", *((each.interface, each.hop, each.time) for each in ONE.hops), ("r1/in", "entered", 1.1))
    Console([ONE, back]).request("trace brain/out")
    title, title_back, one_way, there, there_back, *medians_of_both = terminal.getvalue().splitlines()
    assert title.split() == ["MESSAGE", "TO", "SENT", "RECEIVED", "DELIVERED", "TOTAL", "µs"]
    assert title_back.split()[:2] == ["ENTERED", "BACK"]
    assert one_way.split() == ["m1", "r1/in", "1000", "2000", "7000", "10000"]
    assert there.split()[0] == "m2"
    assert there_back.split() == ["90000", "-", "-", "-"]
    assert len(medians_of_both) == 2
    assert max(map(len, terminal.getvalue().splitlines())) <= 80
