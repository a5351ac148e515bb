"""A real Environment endpoint with a Master and a robot of the test, or its ROS node alone, shared by a module."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import TYPE_CHECKING

import pytest
from twisted.internet.base import ReactorBase

from rce.control.calls.endpoints import NodeSpec, StartNode
from tests.support.domains import domain
from tests.support.endpoints.environment_driver import FakeMaster, driven, wait_for_line

if TYPE_CHECKING:
    from tests.support.endpoints.ros_world import RosWorld


@pytest.fixture(scope="module")
async def master(running_reactor: ReactorBase, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[FakeMaster]:
    """Master of an environment in which node `echo` of package `probe` runs."""
    pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")
    async with driven(running_reactor, tmp_path_factory.mktemp("environment")) as (master, _):
        await master.call(StartNode(NodeSpec("echo", "probe", "echo.py")))
        await wait_for_line(master, "echo", "words is")  # the last thing that it does before it is ready
        yield master


@pytest.fixture(scope="module")
async def world(running_reactor: ReactorBase) -> AsyncIterator[RosWorld]:
    """A ROS node in this process, with a node of another process."""
    pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")
    from tests.support.endpoints.ros_world import ros_world

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        patch.setenv("ROS_DOMAIN_ID", str(domain("ros world")))
        async with ros_world() as made:
            yield made
