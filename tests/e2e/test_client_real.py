"""The contract of the Python client, with a real platform."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from rce.client import Reconnected, Robot
from rce.errors import AlreadyExists
from tests.support.client_contract import ClientContract, Platform
from tests.support.e2e.real_platform import USER, RealPlatform
from tests.support.e2e.traffic import Echo, next_event

GRACE = 60.0  # seconds in which a robot resumes its session, also on a busy machine


class RealWorld(Platform):
    """A real platform for the contract tests. Connections break at the robots' end."""

    def __init__(self, platform: RealPlatform) -> None:
        self._platform = platform
        self._robots: dict[str, Robot] = {}

    def robot(self, name: str) -> Robot:
        robot = Robot(self._platform.url, user=USER, robot=name, password=USER, timeout=60)
        self._robots.setdefault(name, robot)
        return robot

    def break_socket(self, robot: str) -> None:
        connection = self._robots[robot].connection
        assert connection is not None
        connection._websocket.abort()

    async def end_session(self, robot: str) -> None:
        """Break the connection and forget the token, so that the robot cannot resume its session."""
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


async def test_environment_with_the_name_of_its_robot_is_refused(running: RealPlatform) -> None:
    """An environment that exists is taken over, but this one does not exist."""
    async with Robot(running.url, user=USER, robot="same", password=USER) as robot:
        with pytest.raises(AlreadyExists, match="in use by a robot of yours"):
            await robot.environment("same").__aenter__()


async def test_robot_uses_its_environment_again_in_a_new_session(running: RealPlatform) -> None:
    """The platform removes what a robot added to an environment when the robot has left for good."""
    world = RealWorld(running)
    async with world.robot("wanderer") as robot, robot.environment("wandered") as environment:
        echo = await Echo.of(environment)
        await echo.answers()
        events = robot.events()
        await world.end_session("wanderer")
        assert await next_event(events, Reconnected) == Reconnected(resumed=False)
        await echo.answers()
