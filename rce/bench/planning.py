"""Times and lengths of the planners on large maps and a building, beside an exhaustive search and published times."""

from __future__ import annotations

import functools
import statistics
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from rce.mapping.evaluation.simulation.floor_plan import DEPTH, WIDTH, apartment
from rce.mapping.files.maps import read_map
from rce.mapping.geometry import Pose
from rce.mapping.grid import OccupancyGrid
from rce.planning.costmap import Costmap
from rce.planning.failures import NoPath
from rce.planning.planner import PlannerSettings, plan
from rce.planning.search.cells import STRAIGHT, search, step_costs
from rce.planning.search.deadline import Deadline

SIDE, RESOLUTION = 2000, 0.05  # cells, metres
PATIENCE = 60.0  # seconds
PUBLISHED = (
    ("2D A*, a path of about 75 m", "243 ms"),
    ("Hybrid-A*, the same path", "144 ms"),
    ("Hybrid-A*, maps of 147,456 cells, 72 headings", "2 to 20 ms"),
    ("Hybrid-A*, maps of 344,128 cells, 72 headings", "30 to 200 ms"),
)
"""Times of Smac, from the README of nav2_smac_planner, on the machine of its authors."""


class Case(Struct):
    """Start and goal on a map."""

    name: str
    grid: OccupancyGrid
    start: Pose
    goal: Pose


class Figure(Struct):
    """Result of one planner on one map.

    Attributes:
        map: Name of the map.
        planner: Name of the planner.
        milliseconds: Median time of a plan, without that of the costmap.
        length: Metres; None if there is no path.
        ratio: Of astar: cost of its path, by that of the exhaustive search; else length by that of astar.
    """

    map: str
    planner: str
    milliseconds: float
    length: float | None
    ratio: float | None


def cases(maps: list[Path]) -> Iterator[Case]:
    """Yield maps of 2,000 x 2,000 cells from easy to hard, a building, and a long way on each map that is given."""
    far = (SIDE - 40) * RESOLUTION
    corners = Pose(2.0, 2.0, 0.0), Pose(far, far, 0.0)
    for name, cells in synthetic().items():
        start = Pose(50.0, 50.0, 0.0) if name == "trap" else corners[0]
        yield Case(name, OccupancyGrid(cells, RESOLUTION, 0.0, 0.0), start, corners[1])
    yield Case("apartment", building(), Pose(1.0, 5.5, 0.0), Pose(15.0, 9.0, 0.0))
    for path in maps:
        grid = read_map(path)
        yield Case(path.parent.name or path.stem, grid, *_far_apart(grid))


def synthetic() -> dict[str, NDArray[np.int8]]:
    """Return maps (SIDE, SIDE) by name; the goal of `closed` cannot be reached, the way of `snake` is the longest."""
    random = np.random.default_rng(0)
    maps = {name: np.zeros((SIDE, SIDE), np.int8) for name in ("empty", "boxes", "rooms", "trap", "snake", "closed")}
    for row, column, height, width in random.integers((60, 60, 5, 5), (SIDE - 120, SIDE - 120, 60, 60), (1500, 4)):
        maps["boxes"][row : row + height, column : column + width] = 100
    rooms = maps["rooms"]
    rooms[::100], rooms[:, ::100] = 100, 100
    for row in range(0, SIDE, 100):
        for column in range(0, SIDE, 100):
            door = int(random.integers(20, 60))
            rooms[row + door : row + door + 22, column] = 0
            rooms[row, column + door : column + door + 22] = 0
    maps["trap"][200:1800, 1700:1710] = 100
    maps["trap"][200:210, 200:1710] = maps["trap"][1790:1800, 200:1710] = 100
    for index, column in enumerate(range(100, SIDE - 50, 100)):
        maps["snake"][:, column : column + 4] = 100
        gap = slice(20, 60) if index % 2 else slice(-60, -20)
        maps["snake"][gap, column : column + 4] = 0
    maps["closed"][-100:, -100] = maps["closed"][-100, -100:] = 100
    return maps


@functools.cache
def building() -> OccupancyGrid:
    """Return the simulated apartment as a map."""
    columns, rows = np.meshgrid(np.arange(0.0, WIDTH + 1, RESOLUTION), np.arange(0.0, DEPTH + 1, RESOLUTION))
    centres = np.stack([columns.ravel(), rows.ravel()], axis=1) + (RESOLUTION / 2 - 0.5)
    walls = apartment().distance(centres).reshape(rows.shape) < 0.75 * RESOLUTION
    return OccupancyGrid((100 * walls).astype(np.int8), RESOLUTION, -0.5, -0.5)


def _far_apart(grid: OccupancyGrid) -> tuple[Pose, Pose]:
    """Return two poses in the largest region of a map that are far apart."""
    costmap = PlannerSettings().costmap(grid)
    largest = int(np.bincount(costmap.regions[costmap.regions > 0]).argmax())
    rows, columns = np.nonzero(costmap.regions == largest)
    points = costmap.points(rows, columns)
    ends = points[[points.sum(axis=1).argmin(), points.sum(axis=1).argmax()]].tolist()
    (x, y), (goal_x, goal_y) = ends
    return Pose(x, y, 0.0), Pose(goal_x, goal_y, 0.0)


def measure(case: Case, samples: int) -> Iterator[Figure]:
    """Yield the figures of all planners for a case."""
    costmap = PlannerSettings().costmap(case.grid)
    _ = costmap.costs, costmap.regions
    best = 0.0
    for planner in ("astar", "hybrid", "voronoi"):
        settings = PlannerSettings(planner=planner, max_planning_time=PATIENCE, smooth_path=False)
        times, length = [], None
        for _ in range(samples):
            began = time.perf_counter()
            try:
                length = plan(costmap, case.start, case.goal, settings).length
            except NoPath:
                length = None
            times.append(1000 * (time.perf_counter() - began))
        ratio = None
        if length is not None and planner == "astar":
            best = length
            ratio = _cost(costmap, case, informed=True) / _cost(costmap, case, informed=False)
        elif length is not None:
            ratio = length / best
        yield Figure(case.name, planner, statistics.median(times), length, ratio)


def _cost(costmap: Costmap, case: Case, informed: bool) -> float:
    """Return the cost of the path by A*, or by Dijkstra's algorithm over the whole map."""
    costs, width = costmap.costs, costmap.costs.shape[1]
    begin, end = (row * width + column for row, column in (costmap.cell(*each[:2]) for each in (case.start, case.goal)))
    straight, diagonal, ring = step_costs(PlannerSettings().cost_travel_multiplier)
    reached, arrivals = np.empty(costs.size, np.int32), np.empty(costs.size, np.uint8)
    extent = 0.0 if informed else 1e6
    flag = Deadline(PATIENCE).flag
    found = search(
        costs.ravel(), width, begin, end, straight, diagonal, ring, int(informed), extent, reached, arrivals, flag
    )
    return found / STRAIGHT


def table(figures: list[Figure]) -> str:
    """Return the figures as a table in Markdown, with the published ones below."""
    lines = ["| map | planner | time | length | ratio |", "|---|---|---|---|---|"]
    for each in figures:
        length = "no path" if each.length is None else f"{each.length:.1f} m"
        ratio = "" if each.ratio is None else f"{each.ratio:.3f}"
        lines.append(f"| {each.map} | {each.planner} | {each.milliseconds:.1f} ms | {length} | {ratio} |")
    lines += ["", "| published by Smac (README of nav2_smac_planner) | time |", "|---|---|"]
    return "\n".join([*lines, *(f"| {what} | {took} |" for what, took in PUBLISHED)])
