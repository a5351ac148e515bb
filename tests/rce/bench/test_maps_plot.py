"""Plots of maps and of endless runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="needs the extra `bench`")

from matplotlib.figure import Figure

from rce.bench.maps import Mapped, Recorded, Results, Served
from rce.bench.maps_plot import HOUR, plot, plot_endless
from rce.mapping.evaluation.trials import Endless

NAME = "mit-csail.clf"
RECORDED = Recorded(NAME, Path(NAME), 1, 60, 120, 12.0, Path("mit-csail.relations"))
MAPPED = Mapped(NAME, "graph", "recorded", 1.0, 1.0, 0, {"benchmark": (0.03, 0.4), "far": (0.5, 1.0)}, None)


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Figures that were saved."""
    saved: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **options: saved.append(figure))
    return saved


def test_times_of_the_service_are_bars_by_mapper(figures: list[Figure], tmp_path: Path) -> None:
    served = [Served(NAME, "graph", 0.5, 2.0), Served(NAME, "particle", 0.4, 30.0)]
    plot(Results([RECORDED], served, []), tmp_path / "maps.svg")
    times = figures[0].axes[0]
    labels = times.get_legend_handles_labels()[1]
    assert labels == ["transmission", "mapping, graph", "mapping, particle"]
    assert [bars[0].get_height() for bars in times.containers] == [0.5, 2.0, 30.0]


def test_errors_are_beside_those_of_other_systems(figures: list[Figure], tmp_path: Path) -> None:
    plot(Results([RECORDED], [], [MAPPED]), tmp_path / "maps.svg")
    errors = figures[0].axes[1]
    labels = [label.get_text() for label in errors.get_yticklabels()]
    assert labels[-1] == "mit-csail, graph, recorded (benchmark)"
    assert any("GMapping" in label for label in labels)
    assert errors.containers[0][-1].get_width() == 0.03


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("mapped", [[], [Mapped("a", "graph", "none", 1.0, 1.0, 0, {"near": (0.1, 1.0)}, None)]])
def test_results_without_errors_are_drawn(mapped: list[Mapped], tmp_path: Path) -> None:
    picture = tmp_path / "maps.png"
    plot(Results([], [], mapped), picture)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_endless_run_is_drawn_over_hours(figures: list[Figure], tmp_path: Path) -> None:
    scans = np.array([HOUR, 2 * HOUR])
    run = Endless(scans, np.array([0.001, 0.002]), np.array([0.01, 0.05]), np.array([1, 2]) * 1_000_000)
    plot_endless({"a, graph": run}, tmp_path / "endless.svg")
    memory, times = figures[0].axes
    assert np.array(memory.lines[0].get_xdata()).tolist() == [1, 2]
    assert np.array(memory.lines[0].get_ydata()).tolist() == [1, 2]
    assert [line.get_label() for line in times.lines] == ["a, graph, CPU, mean", "a, graph, longest"]
    assert np.array(times.lines[1].get_ydata()).tolist() == pytest.approx([10, 50])
