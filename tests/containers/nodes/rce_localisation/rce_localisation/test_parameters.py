"""Parameters of the localiser node."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from rce.mapping.geometry import Pose


def node_with(start_ros: Callable[..., None], *parameters: str) -> Any:
    import rclpy

    start_ros(*parameters)
    return rclpy.create_node("localiser", automatically_declare_parameters_from_overrides=True)


def test_parameters_of_amcl_without_a_meaning_are_named(
    start_ros: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    from rce_localisation.parameters import declare, initial_pose
    from rce_mapping.parameters import number, text

    node = node_with(start_ros, "max_particles:=2000", "alpha1:=0.2", "scan_topic:=laser", "use_sim_time:=false")
    said: list[str] = []
    monkeypatch.setattr(node.get_logger().__class__, "warning", lambda _self, words: said.append(words))
    declare(node)
    assert said == ["parameters that have no meaning here: alpha1, max_particles"]
    assert (text(node, "scan_topic"), number(node, "laser_max_range")) == ("laser", 30.0)
    assert initial_pose(node) is None
    assert not node.set_parameters([node.get_parameter("scan_topic")])[0].successful, "it is read-only"


def test_initial_pose_is_in_the_plane(start_ros: Callable[..., None]) -> None:
    from rce_localisation.parameters import declare, initial_pose

    node = node_with(start_ros, "set_initial_pose:=true", "initial_pose.x:=1.5", "initial_pose.yaw:=0.5")
    declare(node)
    assert initial_pose(node) == Pose(1.5, 0.0, 0.5)


def test_value_out_of_range_is_refused(start_ros: Callable[..., None]) -> None:
    from rce_localisation.parameters import declare
    from rclpy.exceptions import InvalidParameterValueException

    node = node_with(start_ros, "transform_tolerance:=-1.0")
    with pytest.raises(InvalidParameterValueException):
        declare(node)
