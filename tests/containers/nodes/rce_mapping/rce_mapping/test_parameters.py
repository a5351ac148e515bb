"""Parameters of the nodes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from rce.mapping.mapper import MapperSettings

pytest.importorskip("rclpy", reason="needs the extra `ros`")

import rclpy
from rce_mapping import parameters
from rclpy.exceptions import InvalidParameterValueException
from rclpy.parameter import Parameter

StartRos = Callable[..., None]


@pytest.fixture
def node(start_ros: StartRos, request: pytest.FixtureRequest) -> Iterator[Any]:
    """A node with the parameters, some of them set by indirect parametrization."""
    start_ros(*getattr(request, "param", []))
    node = rclpy.create_node("mapper")
    yield node
    node.destroy_node()


def test_defaults_are_those_of_the_library(node: Any) -> None:
    parameters.declare(node, ["graph", "particle"])
    assert parameters.settings_of(node) == MapperSettings()
    assert parameters.choice(node, parameters.MAPPER, ["graph", "particle"]) == "graph"
    assert parameters.flag(node, "use_odometry")
    assert not parameters.flag(node, "odometry_from_tf")


@pytest.mark.parametrize("node", [["particles:=7", "seed:=3", "resolution:=0.1", "max_range:=12.5"]], indirect=True)
def test_settings_are_read_from_parameters(node: Any) -> None:
    parameters.declare(node, ["graph"])
    assert parameters.settings_of(node) == MapperSettings(resolution=0.1, max_range=12.5, particles=7, seed=3)


@pytest.mark.parametrize("node", [["particles:=0"], ["resolution:=5.0"], ["seed:=-1"]], indirect=True)
def test_value_out_of_range_is_refused(node: Any) -> None:
    with pytest.raises(InvalidParameterValueException):
        parameters.declare(node, ["graph"])


def test_only_the_intervals_can_be_changed(node: Any) -> None:
    parameters.declare(node, ["graph"])
    changed = {
        name
        for name in (parameters.INTERVAL, parameters.UPDATES, "resolution", "odom_timeout")
        if node.set_parameters([Parameter(name, value=0.2)])[0].successful
    }
    assert changed == {parameters.INTERVAL, parameters.UPDATES}
    assert not node.set_parameters([Parameter(parameters.INTERVAL, value=0.0)])[0].successful


@pytest.mark.parametrize(("node", "expected"), [([], []), (["robots:=[one, two]"], ["one", "two"])], indirect=["node"])
def test_list_of_strings(node: Any, expected: list[str]) -> None:
    assert parameters.texts(node, "robots", "Names.") == expected


@pytest.mark.parametrize("node", [["mapper:=best"]], indirect=True)
def test_unknown_choice_is_refused(node: Any) -> None:
    parameters.declare(node, ["graph", "particle"])
    with pytest.raises(ValueError, match="mapper is 'best'; it must be one of: graph, particle"):
        parameters.choice(node, parameters.MAPPER, ["graph", "particle"])


@pytest.mark.parametrize("node", [["mapper:=best"]], indirect=True)
def test_mapper_node_refuses_unknown_mapper(node: Any) -> None:
    from rce_mapping.node import MapperNode

    with pytest.raises(ValueError, match="'best'; it must be one of: graph"):
        MapperNode()
