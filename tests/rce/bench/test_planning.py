"""The bench of planners."""

from __future__ import annotations

from pathlib import Path

import pytest

from rce.bench import planning
from rce.bench.planning import Case, Figure, building, cases, measure, synthetic, table
from rce.mapping.files.outputs import write_map
from rce.mapping.geometry import Pose
from tests.support.planning import walled


def test_astar_costs_what_the_exhaustive_search_costs() -> None:
    figures = {each.planner: each for each in measure(Case("walled", walled(), Pose(2, 2, 0), Pose(8, 2, 0)), 1)}
    assert list(figures) == ["astar", "hybrid", "voronoi"]
    assert figures["astar"].ratio == 1.0
    assert all(each.length is not None and each.length > 12 for each in figures.values())


def test_goal_that_cannot_be_reached_has_no_length() -> None:
    for each in measure(Case("closed", walled(gap=0), Pose(2, 2, 0), Pose(8, 2, 0)), 1):
        assert (each.length, each.ratio) == (None, None)


def test_maps_are_square_and_further_ones_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "SIDE", 400)
    assert {cells.shape for cells in synthetic().values()} == {(planning.SIDE, planning.SIDE)}
    write_map(tmp_path / "map", building())
    found = list(cases([tmp_path / "map.yaml"]))
    assert found[-1].grid.cells.shape == building().cells.shape
    assert found[-1].start != found[-1].goal


def test_table_has_figures_and_published_times() -> None:
    text = table([Figure("rooms", "astar", 12.34, 10.0, 1.0), Figure("closed", "astar", 1.0, None, None)])
    assert "| rooms | astar | 12.3 ms | 10.0 m | 1.000 |" in text
    assert "| closed | astar | 1.0 ms | no path |  |" in text
    assert "243 ms" in text
