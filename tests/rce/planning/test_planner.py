"""Planners by name."""

from __future__ import annotations

import math

import pytest

from rce.api.map_jobs import PLANNERS, Planner, PlanPose, PlanRequest
from rce.errors import InvalidRequest
from rce.mapping.geometry import Pose
from rce.planning.planner import PlannerSettings, plan
from tests.support.planning import ROBOT, walled

GOAL = Pose(8.0, 2.0, 1.0)


@pytest.mark.parametrize("planner", PLANNERS)
def test_each_planner_leads_to_the_goal(planner: Planner) -> None:
    settings = PlannerSettings(planner=planner, footprint=ROBOT, max_planning_time=60)
    path = plan(settings.costmap(walled()), Pose(2, 2, 0), GOAL, settings)
    assert math.dist(path.poses[-1, :2], GOAL[:2]) < 1e-6
    assert math.isclose(path.poses[-1, 2], GOAL.theta, abs_tol=1e-6)
    assert path.length > 12
    assert path.seconds >= 0


def test_ends_must_be_finite() -> None:
    settings = PlannerSettings()
    with pytest.raises(InvalidRequest, match="finite"):
        plan(settings.costmap(walled()), Pose(math.nan, 0, 0), GOAL, settings)


def test_request_has_the_defaults_of_the_settings() -> None:
    place = PlanPose(0, 0)
    assert PlannerSettings.of(PlanRequest(place, place)) == PlannerSettings()
    assert PlannerSettings.of(PlanRequest(place, place, "hybrid", minimum_turning_radius=2)).vehicle == (
        type(PlannerSettings().vehicle)(2.0)
    )
    with pytest.raises(InvalidRequest):
        PlannerSettings.of(PlanRequest(place, place, footprint="round"))
