"""Offloading to a fake platform, with a fake of the robot's own ROS."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from endpoints.bridge.config import BridgeConfig
from endpoints.bridge.offloading import Offloading
from rce.errors import Unavailable, UnknownType
from tests.support.endpoints.fake_local_ros import FakeLocalRos
from tests.support.endpoints.raw_robot import WAIT, eventually
from tests.support.fake_platform import FakePlatform

STRING = "std_msgs/String"
CREATED: dict[str, Any] = {
    "tag": "sky",
    "create": {},
    "parameters": {"speed": 2.5},
    "nodes": [{"tag": "brain", "pkg": "p", "exe": "e"}],
}
TOPICS = {"topics": [{"topic": "/a", "type": STRING}, {"topic": "/b", "type": STRING}]}
PARTS = {("environment", "sky"), ("sky", "brain", "", ""), ("sky", "", "", "speed")}


@pytest.fixture
async def cloud() -> AsyncIterator[FakePlatform]:
    async with FakePlatform() as platform:
        yield platform


@pytest.fixture
async def make(
    cloud: FakePlatform, local: FakeLocalRos, make_config: Callable[..., BridgeConfig]
) -> AsyncIterator[Callable[..., Offloading]]:
    made: list[Offloading] = []

    def create(**keys: Any) -> Offloading:
        whole = {"url": cloud.url, "environment": CREATED, "send": TOPICS}
        made.append(Offloading(make_config(**(whole | keys)), local))
        return made[-1]

    yield create
    for each in made:
        await each.stop()
        if each.failed.done():
            each.failed.exception()  # mark it as retrieved


async def test_flows_are_open_after_start_and_closed_after_stop(
    make: Callable[..., Offloading], cloud: FakePlatform, local: FakeLocalRos
) -> None:
    offloading = make()
    for _ in range(2):  # the second start changes nothing
        await offloading.start()
        assert set(local.interfaces) == {"/a", "/b"}
        assert cloud.resources >= PARTS
        assert len(cloud.connections) == 2
    await offloading.stop()
    assert local.interfaces == {}
    assert ("environment", "sky") not in cloud.resources
    await eventually(lambda: not cloud.peers)
    await offloading.stop()


async def test_environment_of_somebody_else_is_kept(make: Callable[..., Offloading], cloud: FakePlatform) -> None:
    cloud.resources.add(("environment", "sky"))
    offloading = make(environment={"tag": "sky"})
    await offloading.start()
    await offloading.stop()
    assert ("environment", "sky") in cloud.resources


async def test_environment_and_nodes_of_earlier_run_are_reused(
    make: Callable[..., Offloading], cloud: FakePlatform
) -> None:
    cloud.resources |= {("environment", "sky"), ("sky", "brain", "", "")}
    await make().start()
    assert cloud.resources >= PARTS


async def test_rejected_flow_fails_without_further_attempts(
    make: Callable[..., Offloading], cloud: FakePlatform, local: FakeLocalRos
) -> None:
    local.refusals["/b"] = UnknownType("no such type")
    offloading = make()
    with pytest.raises(UnknownType):
        await offloading.start()
    assert isinstance(offloading.failed.exception(), UnknownType)
    assert local.interfaces == {}, "the flow before it is closed"
    assert ("environment", "sky") not in cloud.resources
    await offloading.start()  # the reason is gone meanwhile
    assert set(local.interfaces) == {"/a", "/b"}


async def test_interrupted_start_is_repeated(make: Callable[..., Offloading], local: FakeLocalRos) -> None:
    local.refusals["/b"] = Unavailable("try again")
    offloading = make()
    await asyncio.wait_for(offloading.start(), WAIT)
    assert set(local.interfaces) == {"/a", "/b"}
    assert not offloading.failed.done()


async def test_flows_are_opened_again_after_environment_was_gone(
    make: Callable[..., Offloading], cloud: FakePlatform, local: FakeLocalRos
) -> None:
    await make().start()
    first = local.interfaces["/a"]
    await cloud.send_status("a", topic="environment", containerTag="other", state="gone")
    await cloud.send_status("a", topic="node", nodeTag="brain", containerTag="sky", status=1, lines=["why"])
    await cloud.send_status("a", topic="environment", containerTag="sky", state="gone", reason="out of memory")
    await eventually(lambda: local.interfaces.get("/a", first) is not first)
    await eventually(lambda: len(cloud.connections) == 2)
    assert cloud.frame_types.count("CC") == 2, "events about other things do not interrupt it"


async def test_stop_interrupts_start(make: Callable[..., Offloading], cloud: FakePlatform) -> None:
    cloud.ignores_commands = True
    offloading = make()
    starting = asyncio.create_task(offloading.start())
    await eventually(lambda: "CC" in cloud.frame_types)
    cloud.ignores_commands = False  # else the destruction of the environment would wait for an answer
    await offloading.stop()
    with pytest.raises(Unavailable, match="stopped while it started"):
        await starting
