"""Interfaces by their kinds; the other tests use each kind."""

from __future__ import annotations

import pytest

from rce.protocol.messages.commands import InterfaceType
from tests.support.endpoints.platforms import Platform
from tests.support.endpoints.raw_robot import eventually

OF_ROBOTS = [
    each
    for each in InterfaceType.__args__
    if not each.endswith("Interface")  # type: ignore[attr-defined]
]
TYPES = {"Service": "std_srvs/SetBool", "Action": "example_interfaces/Fibonacci"}


async def test_each_kind_of_a_robot_is_made(platform: Platform) -> None:
    robot = await platform.robot("r", "ack")
    await robot.receive()
    for kind in OF_ROBOTS:
        type = next((TYPES[each] for each in TYPES if kind.startswith(each)), "std_msgs/String")
        await robot.add(kind, kind, type)
    made = platform.endpoint.sessions["testUser/r"].interfaces
    await eventually(lambda: len(made) == len(OF_ROBOTS))
    assert {tag: interface.spec.kind for tag, interface in made.items()} == {kind: kind for kind in OF_ROBOTS}
    await robot.expect_silence()


@pytest.mark.parametrize("kind", ["ActionClientConverter", "ServiceProviderConverter"])
async def test_converter_of_a_type_that_is_not_known_is_refused(platform: Platform, kind: str) -> None:
    robot = await platform.robot("r", "ack")
    await robot.receive()
    await robot.add("x", kind, "unknown_msgs/Thing")
    assert (await robot.receive())["error"]["code"] == "unknown_type"
