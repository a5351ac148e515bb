"""A real Environment endpoint, with a Master and a robot of the test, shared by the tests of a module."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest
from twisted.internet.base import ReactorBase

from rce.control.calls.endpoints import NodeSpec, StartNode
from tests.support.endpoints.environment_driver import FakeMaster, driven


@pytest.fixture(scope="module")
async def master(running_reactor: ReactorBase, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[FakeMaster]:
    """Master of an environment in which node `echo` of package `probe` runs."""
    pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")
    async with driven(running_reactor, tmp_path_factory.mktemp("environment")) as (master, _):
        await master.call(StartNode(NodeSpec("echo", "probe", "echo.py")))
        yield master
