"""Tables of traffic."""

from __future__ import annotations

from rce.bench.traffic.crowd import Crowd
from rce.bench.traffic.flood import Flood
from rce.bench.traffic.report import as_data, as_text

CROWD = Crowd(100, 2, 9_000.0, 1_000, 998, [0.001, 0.002, 0.009], 0.7, 0.4)


def test_table_has_losses_and_times_in_milliseconds() -> None:
    lines = as_text([CROWD], [Flood(100, 60_000.4, 25_000, 35_000)]).splitlines()
    assert lines[3].split() == ["100", "2", "9.0", "1000", "2", "2.0", "9.0", "0.70", "0.40"]
    assert lines[-1].split() == ["100", "60000", "25000", "35000"]


def test_json_has_every_sample() -> None:
    data = as_data([CROWD], [])
    assert data["crowds"][0]["latencies"] == CROWD.latencies
    assert data["floods"] == []
