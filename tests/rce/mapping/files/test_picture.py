"""Picture of a map for people."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from rce.mapping.files.picture import (
    END,
    FOOTER,
    INK,
    LONG_SIDE,
    MARGIN,
    MAX_PIXELS_PER_CELL,
    PATHS,
    START,
    UNKNOWN,
    draw,
)
from rce.mapping.grid import OccupancyGrid

NOWHERE = np.empty((0, 4))


def drawn(cells: NDArray[np.int8], *trajectories: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return the pixels of the picture of a map with cells of 5 cm and its corner at the origin."""
    png = np.frombuffer(draw(OccupancyGrid(cells, 0.05, 0.0, 0.0), *(trajectories or (NOWHERE,))), np.uint8)
    pixels = cv2.imdecode(png, cv2.IMREAD_COLOR)
    assert pixels is not None
    return pixels.astype(np.uint8)


def inside(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the part of a picture that shows the map."""
    return picture[MARGIN:-FOOTER, MARGIN:-MARGIN]


@pytest.mark.parametrize("shape", [(1, 1), (30, 2000), (3000, 2500)])
def test_picture_has_bounded_size_and_shows_walls_and_path(shape: tuple[int, int]) -> None:
    cells = np.zeros(shape, np.int8)
    cells[:, 0] = 100
    picture = drawn(cells, np.array([[0.0, 0.02, 0.02, 0.0]]))
    assert max(inside(picture).shape) <= max(LONG_SIDE, MAX_PIXELS_PER_CELL)
    assert picture.min() < 60, "walls are dark"
    assert np.ptp(picture.astype(int), axis=2).max() > 100, "the trajectory is coloured"


def test_free_unknown_and_occupied_cells_differ_and_y_points_up() -> None:
    """The first row of the cells is the lowest of the picture."""
    ground = inside(drawn(np.array([[0, 0], [-1, 100]], np.int8)))
    size = MAX_PIXELS_PER_CELL
    assert ground.shape == (2 * size, 2 * size, 3)
    low, unknown, wall = ground[size:], ground[:size, :size], ground[:size, size:]
    assert (low == 255).all()
    assert (unknown == UNKNOWN).all()
    assert wall.max() < 60


def test_thin_wall_stays_visible_in_a_large_map() -> None:
    cells = np.zeros((4 * LONG_SIDE, 100), np.int8)
    cells[:, 50] = 100
    across = inside(drawn(cells))[LONG_SIDE // 2].min(axis=1)
    assert len(across) == 25
    assert across.min() < 200


def test_path_leads_from_a_green_to_a_red_dot() -> None:
    path = np.array([[0.0, 1.0, 1.0, 0.0], [1.0, 4.0, 3.0, 0.0]])
    ground = inside(drawn(np.zeros((100, 100), np.int8), path))
    for (x, y), colour in (((1.0, 1.0), START), ((4.0, 3.0), END)):
        column, row = round(x / 0.05 * MAX_PIXELS_PER_CELL), round((5.0 - y) / 0.05 * MAX_PIXELS_PER_CELL)
        assert tuple(ground[row, column].tolist()) == colour
    middle = ground[round(3.0 / 0.05 * MAX_PIXELS_PER_CELL), round(2.5 / 0.05 * MAX_PIXELS_PER_CELL)]
    assert np.ptp(middle.astype(int)) > 50, "the line between them is coloured"


@pytest.mark.parametrize(("columns", "metres"), [(100, 1.0), (1000, 10.0), (10_000, 100.0), (500, 5.0)])
def test_scale_bar_has_a_round_length(columns: int, metres: float) -> None:
    picture = drawn(np.zeros((10, columns), np.int8))
    pixels_per_metre = inside(picture).shape[1] / (columns * 0.05)
    ink = np.flatnonzero((picture[picture.shape[0] - 22] == INK).all(axis=1))
    bar = ink[: np.argmax(np.diff(ink) > 5) + 1]  # what follows is the text
    assert bar[-1] - bar[0] == pytest.approx(metres * pixels_per_metre, abs=3)


def test_each_robot_of_a_team_has_a_path_of_its_own_colour() -> None:
    ways = [np.array([[0, 1.0, y, 0], [1, 4.0, y, 0]]) for y in (1.0, 2.5, 4.0)]
    picture = drawn(np.zeros((100, 100), np.int8), *ways)
    for number in range(3):
        others = [each for each in PATHS[:3] if each != PATHS[number]]
        rows = np.flatnonzero((picture == PATHS[number]).all(axis=2).any(axis=1))
        for other in others:
            assert not np.isin(rows, np.flatnonzero((picture == other).all(axis=2).any(axis=1))).any()
        assert len(rows) > 3
