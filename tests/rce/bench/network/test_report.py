"""Table of the benchmark of bad networks."""

from __future__ import annotations

from rce.bench.network.report import as_data, as_text
from rce.bench.network.run import Result
from rce.bench.network.streams import PERIODS, Arrivals, cdr, sent_at_of_cdr


def result(times: dict[str, list[tuple[float, float]]], ended: list[float]) -> Result:
    arrivals = {name: Arrivals(times.get(name, [])) for name in PERIODS}
    return Result("lte", "rce", 10.0, arrivals, ended)


def test_table_has_share_age_and_recovery_of_each_stream() -> None:
    velocity = [(number / 20, number / 20 + 0.1) for number in range(100)]
    rows = [line.split() for line in as_text([result({"velocity": velocity}, [2.02, 9.0])]).splitlines()[2:]]
    assert rows[0] == ["profile", "mode", "stream", "delivered", "p50", "ms", "p99", "ms", "recovery", "s"]
    assert ["lte", "rce", "velocity", "50", "%", "100", "100", "0.13,", "never"] in rows
    assert ["lte", "rce", "camera", "0", "%", "-", "-", "-"] in rows


def test_message_carries_its_time_and_has_its_size() -> None:
    message = cdr(1000)
    assert len(message) == 1000 + 9
    assert sent_at_of_cdr(message) > 0


def test_data_has_all_samples() -> None:
    data = as_data([result({"scan": [(1.0, 2.0)]}, [])])
    assert data["results"][0]["streams"]["scan"]["times"] == [(1.0, 2.0)]
