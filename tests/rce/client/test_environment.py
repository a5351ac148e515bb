"""Handles of environments."""

from __future__ import annotations

import pytest

from rce.client import Robot
from rce.errors import RceError
from tests.support.client_contract import STRING
from tests.support.fake_platform import KEY, FakePlatform


async def test_context_creates_and_destroys_the_environment(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        async with a.environment("brain", size=2, group_ip="192.168.1.7", restart="no") as brain:
            await brain.add_node("echo", "Test", "stringEcho.py", args="-v")
            assert ("environment", "brain") in fake.resources
        frames = fake.peers["a"].frames
        options = {"size": 2, "groupIP": "192.168.1.7", "restart": "no"}
        assert frames[0]["data"] == {"containerTag": "brain", "containerData": options}
        assert frames[-1]["type"] == "DC"


async def test_publisher_adds_and_connects_both_interfaces(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        brain = a.environment("brain")
        publisher = await brain.publisher("/cmd/vel", STRING)
        assert publisher.tag == "brain_pub_cmd_vel"
        assert publisher.connected
        assert fake.interfaces["brain/pub_cmd_vel"]["addr"] == "/cmd/vel"
        with pytest.raises(RceError):
            await brain.publisher("/cmd/vel", STRING)


async def test_robots_share_an_interface_and_a_guest_has_its_own(fake: FakePlatform) -> None:
    guest = Robot(fake.url, user="testUser", robot="@desk", key=KEY)
    async with fake.robot("a") as a, fake.robot("b") as b, guest:
        for robot in (a, b):
            await robot.environment("brain").publisher("/scan", STRING)
        publisher = await guest.environment("brain").publisher("/scan", STRING)
        assert publisher.tag == "brain_pub_scan"
        tags = {tag for tag in fake.interfaces if tag.startswith("brain/")}
        assert tags == {"brain/pub_scan", "brain/@desk.pub_scan"}
