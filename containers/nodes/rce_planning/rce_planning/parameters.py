"""Parameters of the planner node, named as those of Nav2's planner server, Smac planners and costmaps."""

from __future__ import annotations

from rce_mapping.parameters import choice, declare_fixed, declare_number, flag, number, text
from rclpy.node import Node

from rce.api.map_jobs import MOTION_MODELS, PLANNERS
from rce.planning.costmap import INFLATION, Inflation
from rce.planning.footprint import Footprint
from rce.planning.hybrid import VEHICLE, Vehicle
from rce.planning.planner import PlannerSettings

NUMBERS = {  # default, lowest and highest value, description
    "tolerance": (0.125, 0.0, 100.0, "Metres from the goal at which a path may end if the goal cannot be reached."),
    "cost_travel_multiplier": (2.0, 0.0, 100.0, "Weight of the costs of cells beside the length; of astar."),
    "max_planning_time": (2.0, 0.001, 600.0, "Longest time of a plan, seconds."),
    "robot_radius": (0.2, 0.001, 100.0, "Radius of the robot without a footprint, metres."),
    "inflation_radius": (INFLATION.inflation_radius, 0.0, 100.0, "Metres from an obstacle at which costs end."),
    "cost_scaling_factor": (INFLATION.cost_scaling_factor, 0.0, 1000.0, "Decay of costs, 1/metres."),
    "minimum_turning_radius": (VEHICLE.minimum_turning_radius, 0.01, 100.0, "Metres; of hybrid."),
    "reverse_penalty": (VEHICLE.reverse_penalty, 1.0, 100.0, "Factor of reverse motion; of hybrid."),
    "non_straight_penalty": (VEHICLE.non_straight_penalty, 1.0, 100.0, "Factor of arcs; of hybrid."),
    "change_penalty": (VEHICLE.change_penalty, 0.0, 100.0, "Cost of a change of direction, metres; of hybrid."),
    "cost_penalty": (VEHICLE.cost_penalty, 0.0, 100.0, "Weight of the costs of cells; of hybrid."),
    "analytic_expansion_ratio": (
        VEHICLE.analytic_expansion_ratio,
        0.1,
        100.0,
        "How often curves are tried; hybrid.",
    ),
    "analytic_expansion_max_length": (
        VEHICLE.analytic_expansion_max_length,
        0.0,
        1000.0,
        "Longest curve that is tried, metres; of hybrid.",
    ),
}
TEXTS = {
    "planner": (PLANNERS[0], f"Planner of requests that name none: {', '.join(PLANNERS)}."),
    "footprint": ("", "Corners [[x, y], …] of the robot, metres; empty for a circle of robot_radius."),
    "motion_model_for_search": (MOTION_MODELS[0], f"Of hybrid: {', '.join(MOTION_MODELS)}."),
    "global_frame": ("map", "Frame of the map."),
    "robot_base_frame": ("base_link", "Frame of the robot."),
}
FLAGS = {
    "allow_unknown": (True, "Unknown space is free."),
    "smooth_path": (True, "Paths of astar and voronoi are smoothed."),
}


def declare(node: Node) -> None:
    """Declare all parameters; all are read-only."""
    for name, (default, low, high, description) in NUMBERS.items():
        declare_number(node, name, default, (low, high), description)
    for name, (value, description) in (TEXTS | FLAGS).items():
        declare_fixed(node, name, value, description)


def settings_of(node: Node) -> PlannerSettings:
    """Return the settings from the parameters.

    Raises:
        ValueError: A choice is none of those allowed.
        InvalidRequest: The footprint is wrong.
    """
    model = choice(node, "motion_model_for_search", list(MOTION_MODELS))
    planner = choice(node, "planner", list(PLANNERS))
    outline = text(node, "footprint")
    return PlannerSettings(
        planner=next(each for each in PLANNERS if each == planner),
        footprint=Footprint.parse(outline) if outline else Footprint.circle(number(node, "robot_radius")),
        inflation=Inflation(number(node, "inflation_radius"), number(node, "cost_scaling_factor")),
        allow_unknown=flag(node, "allow_unknown"),
        tolerance=number(node, "tolerance"),
        cost_travel_multiplier=number(node, "cost_travel_multiplier"),
        max_planning_time=number(node, "max_planning_time"),
        smooth_path=flag(node, "smooth_path"),
        vehicle=Vehicle(
            number(node, "minimum_turning_radius"),
            next(each for each in MOTION_MODELS if each == model),
            number(node, "reverse_penalty"),
            number(node, "non_straight_penalty"),
            number(node, "change_penalty"),
            number(node, "cost_penalty"),
            number(node, "analytic_expansion_ratio"),
            number(node, "analytic_expansion_max_length"),
        ),
    )
