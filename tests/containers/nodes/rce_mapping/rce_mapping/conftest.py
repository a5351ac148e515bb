"""The mapper node and a robot."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest


@pytest.fixture
def parameters(request: pytest.FixtureRequest) -> list[str]:
    """Parameters of the mapper, for indirect parametrization."""
    return getattr(request, "param", [])


@pytest.fixture
def robot(start_ros: Callable[..., None], parameters: list[str]) -> Iterator[Any]:
    from rclpy.parameter import Parameter

    from tests.support.containers.mapper_robot import Robot

    start_ros(*parameters)
    robot = Robot([Parameter("map_update_interval", value=3600.0)])
    yield robot
    robot.close()
