"""Result of a run as text and JSON."""

from __future__ import annotations

import json

from rce.bench.chaos.flows import FlowCount
from rce.bench.chaos.report import Result, as_data, as_text

RESULT = Result(
    7,
    100.0,
    {"Master killed": 3, "node stopped": 1},
    500,
    {"disk full": 2},
    [0.1, 0.2],
    {"Master killed": [1.0, 3.0, 2.0], "node stopped": [0.5]},
    [FlowCount("r0 to r1", 1000, 990, 10, 0, 0, 0, 0)],
    disks=True,
)


def test_table_has_median_and_maximum_of_each_kind() -> None:
    rows = [line.split() for line in as_text(RESULT).splitlines()]
    assert ["Master", "killed", "3", "2.00", "s", "3.00", "s"] in rows
    assert ["node", "stopped", "1", "0.50", "s", "0.50", "s"] in rows


def test_text_has_seed_commands_and_messages() -> None:
    text = as_text(RESULT)
    assert "4 faults in 100 s, seed 7" in text
    assert "500 commands acknowledged, all present in 2 comparisons; refused and repeated: disk full 2" in text
    assert "1000 messages sent, 990 arrived, 0 twice" in text
    assert "no disk was full" not in text


def test_data_has_all_recoveries() -> None:
    assert json.loads(json.dumps(as_data(RESULT)))["chaos"]["recoveries"]["Master killed"] == [1.0, 3.0, 2.0]
