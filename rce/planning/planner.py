"""Planners by name, with one type of settings and of result."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rce.api.map_jobs import Planner, PlanRequest
from rce.errors import InvalidRequest
from rce.mapping.geometry import Pose
from rce.mapping.grid import OccupancyGrid
from rce.planning.astar import astar
from rce.planning.costmap import INFLATION, Costmap, Inflation
from rce.planning.footprint import Footprint
from rce.planning.hybrid import VEHICLE, Vehicle, hybrid
from rce.planning.search.deadline import Deadline
from rce.planning.smoothing import smooth, with_headings
from rce.planning.voronoi import voronoi

ROBOT = Footprint.circle(0.2)


@dataclass(frozen=True, slots=True)
class PlannerSettings:
    """Settings of the planners. Names and defaults are those of Nav2's Smac planners, except for `allow_unknown`.

    Attributes:
        planner: Name of the planner.
        footprint: Outline of the robot.
        inflation: Costs around obstacles.
        allow_unknown: Whether unknown space is free.
        tolerance: Metres from the goal at which a path over cells may end if the goal cannot be reached.
        cost_travel_multiplier: Weight of the costs of cells beside the length; 0 for the shortest path.
        max_planning_time: Seconds.
        smooth_path: Whether paths over cells are smoothed.
        vehicle: For the planner `hybrid`.
    """

    planner: Planner = "astar"
    footprint: Footprint = ROBOT
    inflation: Inflation = INFLATION
    allow_unknown: bool = False
    tolerance: float = 0.125
    cost_travel_multiplier: float = 2.0
    max_planning_time: float = 2.0
    smooth_path: bool = True
    vehicle: Vehicle = field(default=VEHICLE)

    @staticmethod
    def of(request: PlanRequest) -> PlannerSettings:
        """Return the settings of a request to the map service.

        Raises:
            InvalidRequest: The footprint is wrong.
        """
        return PlannerSettings(
            planner=request.planner,
            footprint=Footprint.parse(request.footprint),
            allow_unknown=request.allow_unknown,
            tolerance=request.tolerance,
            cost_travel_multiplier=request.cost_travel_multiplier,
            max_planning_time=request.max_planning_time,
            vehicle=Vehicle(request.minimum_turning_radius, request.motion_model_for_search),
        )

    def costmap(self, grid: OccupancyGrid) -> Costmap:
        """Return the costs of a map for this robot."""
        return Costmap(grid, self.footprint, self.inflation, self.allow_unknown)


@dataclass(frozen=True, slots=True)
class PlannedPath:
    """Path from start to goal.

    Attributes:
        poses: (n, 4) x, y, theta in the map frame, metres and radians, and 1 if the pose is reached forward, -1 if in
            reverse.
        seconds: Time that planning took, without that of the costmap.
    """

    poses: NDArray[np.float64]
    seconds: float

    @property
    def length(self) -> float:
        """Metres from start to goal."""
        return float(np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum())


def plan(
    costmap: Costmap, start: Pose, goal: Pose, settings: PlannerSettings, deadline: Deadline | None = None
) -> PlannedPath:
    """Plan a path.

    Args:
        costmap: Costs of the map for the robot; see `PlannerSettings.costmap`.
        start: Start, map frame.
        goal: Goal, map frame.
        settings: Planner and its settings.
        deadline: Time limit in place of the one of the settings, by which another thread can end the search.

    Raises:
        NoPath: There is no path; the error says why.
        InvalidRequest: Start or goal are not finite.
    """
    if not all(math.isfinite(value) for value in (*start, *goal)):
        raise InvalidRequest(f"start {tuple(start)} and goal {tuple(goal)} must be finite numbers")
    with deadline or Deadline(settings.max_planning_time) as limit:
        if settings.planner == "hybrid":
            poses, _ = hybrid(costmap, start, goal, settings.vehicle, limit)
        else:
            poses = _over_cells(costmap, start, goal, settings, limit)
        return PlannedPath(poses, limit.elapsed)


def _over_cells(
    costmap: Costmap, start: Pose, goal: Pose, settings: PlannerSettings, deadline: Deadline
) -> NDArray[np.float64]:
    if settings.planner == "voronoi":
        points, _ = voronoi(costmap, start, goal, settings.tolerance, deadline)
    else:
        points, _ = astar(costmap, start, goal, settings.tolerance, settings.cost_travel_multiplier, deadline)
    return with_headings(smooth(costmap, points) if settings.smooth_path else points, goal.theta)
