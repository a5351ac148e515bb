"""`rce bench fleet`: all phases with a small fleet and a real Master."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from twisted.internet.base import ReactorBase

from rce.bench import fleet
from rce.bench.fleet import Phase, Size

PHASES = [
    ("task sets and Robot endpoints join", 6),
    ("robots log in", 7),
    ("environments", 7),
    ("interfaces", 80),
    ("connections", 16),
    ("idle for 0.2 s", 14),
    ("list of all robots", 8),
    ("list of all environments", 8),
    ("environments of dead machines run again", None),  # as many as were placed there
    ("processes join after a restart of the Master", 12),
]


@pytest.mark.slow
async def test_all_phases_end(reactor: ReactorBase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fleet, "IDLE", 0.2)
    monkeypatch.setattr(fleet, "MACHINE_GRACE", 1)
    reported: list[str] = []
    size = Size(machines=3, robots=8)
    with tempfile.TemporaryFile("w+") as log:
        phases = await fleet.measure(reactor, tmp_path, size, log, reported.append)
    found = [(phase.name, number and phase.number) for phase, (_, number) in zip(phases, PHASES, strict=True)]
    assert found == PHASES
    assert len(reported) == len(phases)
    assert sum(len(phase.probes) for phase in phases) > 0
    assert "environments of dead machines run again" in fleet.as_text(size, phases)
    assert fleet.as_data(size, phases)["size"] == {"machines": 3, "robots": 8}


def test_table_has_the_costs_of_each() -> None:
    phase = Phase("robots log in", 100, seconds=10.0, processor=2.0, memory=50_000_000, probes=[0.001] * 9 + [0.5])
    row = fleet.as_text(Size(1, 100), [phase]).splitlines()[-1].split()
    assert row == ["robots", "log", "in", "100", "10.0", "20.00", "0.20", "50", "1.0", "500.0", "0"]
