"""Robots behind their sockets."""

from __future__ import annotations

from endpoints.robot.client import RobotClient
from tests.support.endpoints.platforms import Platform
from tests.support.endpoints.raw_robot import USER, eventually


async def test_normal_closure_ends_the_session_of_a_client_with_features(platform: Platform) -> None:
    a = await platform.robot("a", "events")
    assert f"{USER}/a" in platform.endpoint.sessions
    await a.socket.close()
    await eventually(lambda: f"{USER}/a" not in platform.endpoint.sessions)


async def test_features_are_unknown_before_the_login(platform: Platform) -> None:
    assert RobotClient(platform.endpoint).features == frozenset()
