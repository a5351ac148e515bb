"""Benchmark of the control plane."""

from __future__ import annotations

from pathlib import Path

import pytest
from twisted.internet.base import ReactorBase

from rce.bench import control
from rce.bench.control import Phase


async def test_lower_bounds_are_measured(reactor: ReactorBase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control, "FLOOR_SAMPLES", 3)
    phases = await control.floors(reactor, tmp_path)
    assert [len(phase.seconds) for phase in phases] == [3, 3]
    assert all(0 < min(phase.seconds) <= phase.elapsed for phase in phases)


def test_table_has_medians_and_rates() -> None:
    phases = [Phase(0, "bare call", 0.5, [0.001] * 100), Phase(20, "create environment", 40.0, [2.0, 4.0])]
    rows = [line.split() for line in control.as_text(phases).splitlines()[3:]]
    assert rows[0] == ["bare", "call", "100", "1.00", "1.00", "200"]
    assert rows[1] == ["create", "environment", "20", "2", "3000.00", "4000.00", "0.05"]
    assert [each["kind"] for each in control.as_data(phases)["phases"]] == ["bare call", "create environment"]
