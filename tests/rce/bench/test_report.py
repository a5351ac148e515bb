"""Tests of tables and JSON data."""

from __future__ import annotations

from rce.bench.report import aligned, as_data, as_text
from rce.bench.statistics import Series


def measured() -> list[Series]:
    nodes, robot = Series("n2n string", "topic"), Series("r2c json", "topic", "n2n string")
    for size in (10, 1_000_000):
        for number in range(1, 4):
            nodes.add(size, number / 1000)
            robot.add(size, number / 400)
    return [nodes, robot]


def test_table_has_medians_with_ratios() -> None:
    lines = [line.split() for line in as_text(measured()).splitlines()]
    assert ["10", "2.00", "5.00", "(2.5)"] in lines
    assert ["1,000,000", "2.00", "5.00", "(2.5)"] in lines
    assert ["up", "to", "10", "kB", "2.00", "5.00", "(2.5)"] in lines
    assert ["services"] not in lines


def test_data_has_all_samples() -> None:
    data = as_data(measured())
    assert data["series"][1]["seconds"]["10"] == [0.0025, 0.005, 0.0075]
    assert data["series"][1]["beside"] == "n2n string"
    assert data["machine"]["cores"] >= 1


def test_columns_are_aligned() -> None:
    assert list(aligned([["a", "bb"], ["ccc", "d"]])) == ["  a  bb", "ccc   d"]
