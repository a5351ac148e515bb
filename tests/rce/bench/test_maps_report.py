"""Results of mappers as text and as JSON."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rce.bench.maps import Mapped, Recorded, Results, Served
from rce.bench.maps_report import as_data, as_text, baselines, endless_data, endless_text
from rce.mapping.evaluation.trials import Endless

RECORDED = Recorded("a.log", Path("a.log"), 1_500_000, 60, 120, 12.4, None)


def test_report_contains_results_of_other_systems() -> None:
    name = "mit-csail.clf.gz"
    recorded = Recorded(name, Path(name), 835_101, 1988, 3976, 374.0, Path("mit-csail.relations"))
    mapped = Mapped(name, "graph", "recorded", 3.5, 4.0, 28_000_000, {"benchmark": (0.0274, 0.361)}, None)
    lines = as_text(Results([recorded], [Served(name, "graph", 0.1, 19.3)], [mapped])).splitlines()
    assert next(line for line in lines if "3976" in line).split() == [
        name,
        "0.84",
        "1988",
        "3976",
        "374",
        "0.10",
        "19.3",
    ]
    assert any(line.split()[-2:] == ["0.027", "0.36°"] for line in lines)
    assert any("GMapping" in line and "0.043" in line for line in lines)


def lines_of(results: Results) -> list[list[str]]:
    return [line.split() for line in as_text(results).splitlines()]


def test_maps_without_the_service_have_no_times_of_it() -> None:
    lines = lines_of(Results([RECORDED], [], []))
    assert ["recording", "MB", "scans", "messages", "way", "m"] in lines
    assert ["a.log", "1.50", "60", "120", "12"] in lines


def test_mappers_are_columns_of_the_service() -> None:
    served = [Served("a.log", "graph", 0.5, 2.0), Served("a.log", "particle", 0.4, 30.0)]
    lines = lines_of(Results([RECORDED], served, []))
    assert ["a.log", "1.50", "60", "120", "12", "0.40", "2.0", "30.0"] in lines


@pytest.mark.parametrize(("closed", "shown"), [(True, ["closed"]), (False, ["OPEN"]), (None, [])])
def test_mapper_alone_shows_its_errors_and_loops(closed: bool | None, shown: list[str]) -> None:
    mapped = Mapped("a.log", "graph", "noisy", 3.52, 4.0, 28_400_000, {"near": (0.01, 0.5)}, closed)
    assert ["a.log", "graph", "noisy", "3.5", "28", "0.010", "0.50°", *shown] in lines_of(Results([], [], [mapped]))


def test_missing_error_of_one_mapper_leaves_a_gap() -> None:
    rows = [
        Mapped("a", "graph", "noisy", 1.0, 1.0, 0, {"near": (0.01, 0.5), "far": (0.2, 1.0)}, None),
        Mapped("b", "graph", "noisy", 1.0, 1.0, 0, {"far": (0.3, 1.5)}, None),
    ]
    lines = lines_of(Results([], [], rows))
    assert ["b", "graph", "noisy", "1.0", "0", "0.300", "1.50°"] in lines


def test_other_systems_are_known_by_the_name_before_the_suffixes() -> None:
    assert baselines("mit-csail.clf.gz") == baselines("mit-csail.log") != ()
    assert baselines("other.log") == ()


def test_data_is_json_with_paths_as_text() -> None:
    data = json.loads(json.dumps(as_data(Results([RECORDED], [], []))))
    assert data["recordings"][0]["path"] == "a.log"
    assert data["machine"]["cores"] >= 1


ENDLESS = Endless(
    np.array([100, 200, 300, 400]),
    np.array([0.001, 0.002, 0.002, 0.001]),
    np.array([0.01, 0.05, 0.02, 0.01]),
    np.array([100, 110, 120, 130]) * 1_000_000,
)


def test_endless_run_shows_memory_at_three_times_and_the_longest_scan() -> None:
    cells = endless_text({"a, graph": ENDLESS}).splitlines()[1].split()
    assert cells == ["a,", "graph", "400", "100", "110", "130", "1.50", "0.50", "50", "ms"]


def test_endless_run_in_json_has_all_samples() -> None:
    runs = json.loads(json.dumps(endless_data({"a, graph": ENDLESS})))["runs"]
    assert runs["a, graph"]["scans"] == [100, 200, 300, 400]
    assert runs["a, graph"]["memory"][-1] == 130_000_000
