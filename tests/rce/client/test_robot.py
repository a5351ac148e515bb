"""The client contract at the fake platform, and the life cycle of a robot."""

from __future__ import annotations

import pytest

from rce.errors import InvalidRequest, Unavailable
from tests.support.client_contract import STRING, ClientContract, Platform
from tests.support.fake_platform import FakePlatform, FakePlatformAdapter


class TestRobotAtFakePlatform(ClientContract):
    @pytest.fixture
    def platform(self, fake: FakePlatform) -> Platform:
        return FakePlatformAdapter(fake)


async def test_robot_can_be_opened_again_only_after_a_failure(fake: FakePlatform) -> None:
    a = fake.robot()
    fake.refuse_robots(503, "the Master is away")
    with pytest.raises(Unavailable, match="away"):
        await a.open()
    fake.refuse_robots(0, "")
    async with a:
        with pytest.raises(InvalidRequest, match="make a new one"):
            await a.open()
    with pytest.raises(InvalidRequest, match="make a new one"):
        await a.open()


async def test_robot_is_unavailable_before_open_and_after_close(fake: FakePlatform) -> None:
    a = fake.robot()
    with pytest.raises(Unavailable, match="open"):
        await a.create_environment("brain")
    async with a:
        subscriber = await a.subscriber("in", STRING)
        assert a.connected
    assert not a.connected
    with pytest.raises(Unavailable):
        await a.create_environment("brain")
    with pytest.raises(Unavailable):
        await subscriber.get(10)
    assert [event async for event in a.events()] == []
    await a.close()
