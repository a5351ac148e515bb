"""Parameters of the planner node."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from rce.errors import InvalidRequest
from rce.planning.planner import PlannerSettings


def node_with(start_ros: Callable[..., None], *parameters: str) -> Any:
    import rclpy
    from rce_planning.parameters import declare

    start_ros(*parameters)
    node = rclpy.create_node("planner")
    declare(node)
    return node


def test_defaults_are_those_of_the_library_except_for_unknown_space(start_ros: Callable[..., None]) -> None:
    from rce_planning.parameters import settings_of

    assert settings_of(node_with(start_ros)) == replace(PlannerSettings(), allow_unknown=True)


def test_values_are_taken(start_ros: Callable[..., None]) -> None:
    from rce_planning.parameters import settings_of

    words = ("footprint:='[[0.3, 0.2], [0.3, -0.2], [-0.3, 0.0]]'", "planner:=hybrid", "minimum_turning_radius:=1.5")
    settings = settings_of(node_with(start_ros, *words, "motion_model_for_search:=REEDS_SHEPP", "tolerance:=0.5"))
    assert len(settings.footprint.corners) == 3
    assert (settings.planner, settings.tolerance) == ("hybrid", 0.5)
    assert (settings.vehicle.minimum_turning_radius, settings.vehicle.motion_model_for_search) == (1.5, "REEDS_SHEPP")


@pytest.mark.parametrize("word", ["planner:=magic", "motion_model_for_search:=SIDEWAYS", "footprint:=round"])
def test_wrong_value_is_refused(start_ros: Callable[..., None], word: str) -> None:
    from rce_planning.parameters import settings_of

    with pytest.raises((ValueError, InvalidRequest)):
        settings_of(node_with(start_ros, word))
