"""Compiled inner loops of grids and of correlative scan matching."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from rce.mapping.matching.kernels import SATURATED, correlate, stamp_hits, trace_rays
from tests.support.paths import ROOT

HIT, MISS, LIMIT = 10, 3, 100


def stamped(*hits: tuple[float, float], sigma: float = 2.0) -> NDArray[np.uint8]:
    field = np.zeros((21, 31), np.uint8)
    stamp_hits(field, np.array(hits, np.float64), sigma)
    return field


def test_likelihood_is_a_gaussian_of_the_distance() -> None:
    field = stamped((15.0, 10.0))
    for column, row in ((15, 10), (17, 10), (15, 7), (18, 13)):
        squared = (column - 15) ** 2 + (row - 10) ** 2
        assert field[row, column] == round(255 * math.exp(-squared / 8))
    assert field[10, 21] == 0, "beyond 2.5 sigma"


def test_nearest_hit_decides_and_order_does_not_matter() -> None:
    hits = (12.3, 10.2), (15.0, 9.0)
    field = stamped(*hits)
    np.testing.assert_array_equal(field, stamped(*reversed(hits)))
    np.testing.assert_array_equal(field, np.maximum(stamped(hits[0]), stamped(hits[1])))


@pytest.mark.parametrize("hit", [(4.4, 10.0), (26.0, 10.0), (15.0, 4.0), (15.0, 16.0), (-50.0, 1e6)])
def test_hit_near_the_edge_is_ignored(hit: tuple[float, float]) -> None:
    assert stamped(hit).max() == 0


def test_hit_in_a_saturated_cell_changes_nothing() -> None:
    field = np.zeros((21, 31), np.uint8)
    field[10, 15] = SATURATED
    before = field.copy()
    stamp_hits(field, np.array([[15.2, 10.0]]), 2.0)
    np.testing.assert_array_equal(field, before)


def traced(sensor: tuple[float, float], *ends: tuple[float, float]) -> NDArray[np.int16]:
    grid = np.zeros((9, 9), np.int16)
    trace_rays(grid, *sensor, np.array(ends, np.float64), HIT, MISS, LIMIT)
    return grid


@pytest.mark.parametrize("end", [(8.0, 4.0), (0.0, 4.0), (4.0, 8.0), (4.0, 0.0)])
def test_cells_before_the_end_of_a_beam_are_free(end: tuple[float, float]) -> None:
    grid = traced((4.0, 4.0), end)
    assert grid[int(end[1]), int(end[0])] == HIT
    assert [int(count) for count in (np.count_nonzero(grid == -MISS), np.count_nonzero(grid))] == [4, 5]


def test_beam_passes_neighbouring_cells_only() -> None:
    grid = traced((0.2, 0.1), (7.9, 5.3))
    rows, columns = np.nonzero(grid)
    assert len(rows) == 1 + 8 + 5
    order = np.argsort(rows + columns)
    steps = np.abs(np.diff(rows[order])) + np.abs(np.diff(columns[order]))
    assert (steps == 1).all()
    distance = np.abs((columns - 0.2) * 5.2 - (rows - 0.1) * 7.7) / math.hypot(5.2, 7.7)
    assert distance.max() < math.sqrt(0.5), "each cell is touched by the beam"


def test_beam_within_one_cell_only_hits() -> None:
    grid = traced((4.1, 4.1), (3.9, 4.3))
    assert (int(grid[4, 4]), int(np.count_nonzero(grid))) == (HIT, 1)


def test_log_odds_are_bounded() -> None:
    grid = traced((0.0, 4.0), *[(8.0, 4.0)] * 50)
    assert (grid[4, 8], grid[4, 4]) == (LIMIT, -LIMIT)


CORNER = np.array([[float(i), 0.0] for i in range(12)] + [[0.0, float(i)] for i in range(1, 12)])


def searched(shift: tuple[float, float, float], **changes: float) -> tuple[float, float, float, float]:
    """Search a corner in a field that has it at (20, 15), from a place that is off by `shift`."""
    field = np.zeros((50, 60), np.uint8)
    stamp_hits(field, CORNER + np.array([20.0, 15.0]), 1.0)
    given = {"stride": 1, "steps": 4, "turns": 3, "turn": 0.1, "move_cost": 0.0, "turn_cost": 0.0, **changes}
    x, y, theta = shift
    return correlate(
        field,
        CORNER,
        20.0 + x,
        15.0 + y,
        theta,
        int(given["stride"]),
        int(given["steps"]),
        int(given["turns"]),
        given["turn"],
        given["move_cost"],
        given["turn_cost"],
    )


@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (3.0, -4.0, 0.2), (-1.0, 2.0, -0.3)])
def test_best_pose_of_the_lattice_is_found(shift: tuple[float, float, float]) -> None:
    assert searched(shift) == pytest.approx((20.0, 15.0, 0.0, 1.0), abs=1e-9)


def test_pose_outside_of_the_window_is_not_found() -> None:
    x, _, _, score = searched((6.0, 0.0, 0.0))
    assert x == 22.0
    assert score < 0.8


def test_penalties_hold_the_pose_at_the_centre() -> None:
    assert searched((2.0, 0.0, 0.0), move_cost=1.0)[0] == 22.0
    assert searched((0.0, 0.0, 0.2), turn_cost=100.0)[2] == 0.2
    assert searched((2.0, 0.0, 0.0), move_cost=0.01)[3] == pytest.approx(1.0 - 0.04)


def test_points_outside_of_the_field_count_as_nothing() -> None:
    field = np.full((20, 20), 255, np.uint8)
    points = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, -100.0], [1.0, 1.0]])
    assert correlate(field, points, 10.0, 10.0, 0.0, 1, 0, 0, 0.0, 0.0, 0.0)[3] == 0.5


@pytest.mark.slow
def test_compilation_is_announced_once_and_its_result_is_kept(tmp_path: Path) -> None:
    (tmp_path / "two_kernels.py").write_text(
        "from rce.mapping.matching.kernels import compiled\n"
        "@compiled('int64(int64)')\ndef one(x): return x + 1\n"
        "@compiled('int64(int64)')\ndef two(x): return x + 2\n"
    )
    variables = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}

    def announcements() -> int:
        words = [sys.executable, "-c", "import two_kernels"]
        done = subprocess.run(words, env=variables, cwd=ROOT, capture_output=True, text=True, check=True, timeout=120)
        return done.stderr.count("compiling numerical kernels")

    assert announcements() == 1
    assert announcements() == 0
