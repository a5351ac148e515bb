"""The platform that the examples of the documentation run at."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from tests.support.e2e.real_platform import RealPlatform


@pytest.fixture(scope="session")
async def platform(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[RealPlatform]:
    """One platform for all examples, whose robots and environments have different names."""
    pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")
    async with RealPlatform(tmp_path_factory.mktemp("examples")) as platform:
        yield platform
