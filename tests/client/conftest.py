"""Fake platforms for the tests of the client."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest
from client_contract import Platform
from fake_platform import PASSWORD, FakePlatform

from rce.client import Robot


class FakeWorld(Platform):
    """The fake, as the contract suite sees it."""

    def __init__(self, fake: FakePlatform) -> None:
        self.fake = fake

    def robot(self, name: str) -> Robot:
        return Robot(self.fake.url, user="testUser", robot=name, password=PASSWORD, timeout=10)

    def break_socket(self, robot: str) -> None:
        self.fake.break_socket(robot)

    async def forget(self, robot: str) -> None:
        await self.fake.forget(robot)


@pytest.fixture
async def fake() -> AsyncIterator[FakePlatform]:
    async with FakePlatform() as platform:
        yield platform


@pytest.fixture
async def original() -> AsyncIterator[FakePlatform]:
    """A server that knows no features."""
    async with FakePlatform(None) as platform:
        yield platform
