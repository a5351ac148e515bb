"""Plots of round trips."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="needs the extra `bench`")

from matplotlib.figure import Figure

from rce.bench.plot import plot
from rce.bench.statistics import Series

ALL = [
    Series("tcp", "floor", seconds={10: [0.001], 1000: [0.002]}),
    Series("n2n string", "topic", seconds={1000: [0.003, 0.005, 0.004], 10: [0.001]}),
    Series("n2n service", "service", seconds={10: [0.001]}),
]


@pytest.fixture
def drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Figure:
    """The figure of `ALL`."""
    figures: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **options: figures.append(figure))
    plot(ALL, tmp_path / "rtt.svg")
    return figures[0]


def test_bare_echoes_are_beside_topics_and_services(drawn: Figure) -> None:
    topics, services = drawn.axes
    assert [line.get_label() for line in topics.lines] == ["tcp", "n2n string"]
    assert [line.get_label() for line in services.lines] == ["tcp", "n2n service"]


def test_medians_in_milliseconds_are_drawn_by_size(drawn: Figure) -> None:
    line = drawn.axes[0].lines[1]
    assert np.array(line.get_xdata()).tolist() == [10, 1000]
    assert np.array(line.get_ydata()).tolist() == pytest.approx([1.0, 4.0])


@pytest.mark.parametrize(("suffix", "start"), [("svg", b"<?xml"), ("png", b"\x89PNG")])
def test_suffix_determines_the_format(suffix: str, start: bytes, tmp_path: Path) -> None:
    picture = tmp_path / f"rtt.{suffix}"
    plot([], picture)
    assert picture.read_bytes().startswith(start)
