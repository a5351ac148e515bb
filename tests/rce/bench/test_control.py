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
    phases = [
        Phase(0, "bare call", 0.5, [0.001] * 100),
        Phase(20, "create environment", 40.0, [2.0, 4.0]),
        Phase(2, "connect, 50 a frame", 1.0, [0.5, 1.0], items=50),
    ]
    rows = [line.split() for line in control.as_text(phases).splitlines()[3:]]
    assert rows[0] == ["bare", "call", "100", "1.00", "1.00", "200"]
    assert rows[1] == ["create", "environment", "20", "2", "3000.00", "4000.00", "0.05"]
    assert rows[2][-5:] == ["2", "100", "750.00", "1000.00", "100"], "a rate of connections, times of frames"
    assert [(each["kind"], each["items"]) for each in control.as_data(phases)["phases"]] == [
        *[("bare call", 1), ("create environment", 1), ("connect, 50 a frame", 50)]
    ]
