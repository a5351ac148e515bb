"""The client's contract at a real platform."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest
from client_contract import ClientContract, Platform
from real_platform import USER, RealPlatform

from rce.client import Robot

GRACE = 1.0


class RealWorld(Platform):
    """A real platform, as the contract suite sees it; sockets break at the robots' own end."""

    def __init__(self, platform: RealPlatform) -> None:
        self._platform = platform
        self._robots: dict[str, Robot] = {}

    def robot(self, name: str) -> Robot:
        robot = Robot(self._platform.url, user=USER, robot=name, password=USER, timeout=10)
        self._robots.setdefault(name, robot)
        return robot

    def break_socket(self, robot: str) -> None:
        connection = self._robots[robot].connection
        assert connection is not None
        connection._socket.transport.abort()

    async def forget(self, robot: str) -> None:
        """Without its token it cannot resume: it is let in when its grace time is over."""
        self._robots[robot]._session._token = ""
        self.break_socket(robot)


@pytest.fixture(scope="module")
async def running(arguments: list[str], tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[RealPlatform]:
    async with RealPlatform(tmp_path_factory.mktemp("client"), *arguments, "--grace", str(GRACE)) as platform:
        yield platform


class TestClientAtRealPlatform(ClientContract):
    @pytest.fixture
    def platform(self, running: RealPlatform) -> Platform:
        return RealWorld(running)
