"""Failures of a run are told with the ends of history and log."""

from __future__ import annotations

from pathlib import Path

from rce.bench.chaos.history import History
from rce.bench.chaos.violations import violation
from rce.errors import TimedOut


def test_failure_has_its_reasons_the_seed_and_the_ends_of_history_and_log(tmp_path: Path) -> None:
    history = History()
    history.add("r1", "add parameter", "acknowledged")
    (tmp_path / "log").write_text('{"level":"info","message":"fine"}\n{"level":"critical","message":"broken"}\n')
    errors = ExceptionGroup("", [ExceptionGroup("", [TimedOut("too long")]), AssertionError("wrong")])
    text = str(violation(errors, 7, tmp_path, history))
    assert "TimedOut: too long\nAssertionError: wrong\nseed 7" in text
    assert "r1        add parameter: acknowledged" in text
    assert "broken" in text
    assert "fine" not in text
