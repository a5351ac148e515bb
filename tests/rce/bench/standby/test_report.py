"""Text of a result."""

from __future__ import annotations

from rce.bench.chaos.flows import FlowCount
from rce.bench.standby.report import Result, as_data, as_text

RESULT = Result(
    7, 100.0, {"leader: kill": 2}, 50, {"unavailable": 3}, 40, 3, [9.5], {"leader: kill": [1.0, 2.0]}, [0.5],
    [FlowCount("a to b", 100, 100, 0, 0, 0, 0, 0)], 0.2, clocks=False,
)  # fmt: skip


def test_text_has_all_figures() -> None:
    text = as_text(RESULT)
    assert "2 faults in 100 s, seed 7, 3 terms" in text
    assert "50 commands acknowledged, all present in 1 comparisons" in text
    assert "take-over: 1 times, 9.50 s, 9.50 s" in text
    assert "no clock jumped" in text
    assert text.splitlines()[-1].split() == ["leader:", "kill", "2", "1.50", "s,", "2.00", "s"]


def test_data_has_the_result() -> None:
    assert as_data(RESULT)["standby"]["terms"] == 3
