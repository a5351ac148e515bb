"""Waiting until nodes have discovered this process; with real nodes, and a clock that the test turns."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import AsyncIterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

import rclpy
from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_msgs.msg import String

from endpoints.environment.discovery import HEAD_START, LIMIT, SETTLING_TIME, _services, after_discovery
from endpoints.environment.ros_services import RawClient
from tests.support.endpoints.actions import spinning
from tests.support.endpoints.ros_world import LIMIT as TEST_LIMIT
from tests.support.endpoints.ros_world import RosWorld


@pytest.fixture
def topic() -> str:
    return f"/waits_{uuid.uuid4().hex[:8]}"  # the nodes of earlier tests are not at it


class Waiting:
    """A wait for the nodes that subscribe to the topic; `now` is the time."""

    def __init__(self, world: RosWorld, topic: str) -> None:
        self.topic = topic
        self.now = 0.0
        self.over = asyncio.Event()
        self.looked = asyncio.Event()
        self.unknown: list[TopicEndpointInfo] = []
        self._world = world

    @classmethod
    async def begin(cls, world: RosWorld, topic: str) -> Waiting:
        made = cls(world, topic)
        after_discovery(world.ros, made._nodes, made._end, lambda: made.now)
        return made

    def _nodes(self) -> list[TopicEndpointInfo]:
        self.looked.set()
        return self.unknown + self._world.ros.node.get_subscriptions_info_by_topic(self.topic)

    def _end(self) -> None:
        self.over.set()

    async def end(self) -> None:
        """Let the request be sent, and wait for the end."""
        self.now += HEAD_START
        await asyncio.wait_for(self.over.wait(), TEST_LIMIT)

    async def lasts(self) -> None:
        """Check that the wait goes on after the nodes were looked at three more times."""
        for _ in range(3):
            self.looked.clear()
            await asyncio.wait_for(self.looked.wait(), TEST_LIMIT)
        assert not self.over.is_set()


@pytest.fixture
async def node(world: RosWorld, topic: str) -> AsyncIterator[Node]:
    """A node with parameter services that subscribes to the topic, in another participant."""
    made = rclpy.create_node("asked", namespace="/here", context=world.other.context)
    made.create_subscription(String, topic, lambda message: None, 10)
    await world.until(lambda: bool(world.ros.node.get_subscriptions_info_by_topic(topic)))
    await world.until(lambda: bool(_services(world.ros)))
    yield made
    made.destroy_node()
    await world.until(lambda: not _services(world.ros))


async def test_node_that_has_answered_sends_its_next_message_to_earlier_subscriptions(
    world: RosWorld, node: Node, topic: str
) -> None:
    def create() -> Any:
        return world.ros.node.create_subscription(String, f"{topic}/answers", lambda message: None, 10)

    subscription = create()
    async with spinning(node):
        await (await Waiting.begin(world, topic)).end()
        publisher = node.create_publisher(String, f"{topic}/answers", 10)
        publisher.publish(String(data="at once"))
        taken: list[Any] = []

        def take() -> bool:
            taken.extend(filter(None, [subscription.handle.take_message(String, False)]))
            return bool(taken)

        await world.until(take)
    assert taken[0][0].data == "at once"


async def test_client_is_removed_after_the_answer(world: RosWorld, node: Node, topic: str) -> None:
    service = "/here/asked/get_parameter_types"
    async with spinning(node):
        await (await Waiting.begin(world, topic)).end()
        await world.until(lambda: world.ros.node.count_clients(service) == 0)


async def test_busy_node_is_waited_for_until_the_limit(world: RosWorld, node: Node, topic: str) -> None:
    waiting = await Waiting.begin(world, topic)
    await world.until(lambda: world.ros.node.count_clients("/here/asked/get_parameter_types") == 1)
    waiting.now = LIMIT - 0.001
    await waiting.lasts()
    waiting.now = LIMIT
    await waiting.end()


async def test_service_of_which_only_a_part_is_known_is_waited_for_until_the_limit(
    world: RosWorld, node: Node, topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RawClient, "available", lambda client: False)
    waiting = await Waiting.begin(world, topic)
    waiting.now = LIMIT - 0.001
    await waiting.lasts()
    waiting.now = LIMIT
    await waiting.end()


async def test_node_without_parameter_services_is_given_a_pause(world: RosWorld, topic: str) -> None:
    subscription = world.other.create_subscription(String, topic, lambda message: None, 10)
    await world.until(lambda: bool(world.ros.node.get_subscriptions_info_by_topic(topic)))
    waiting = await Waiting.begin(world, topic)
    waiting.now = SETTLING_TIME - 0.001
    await waiting.lasts()
    waiting.now = SETTLING_TIME
    await waiting.end()
    world.other.destroy_subscription(subscription)


async def test_nodes_that_are_not_known_yet_are_given_a_pause(world: RosWorld, node: Node, topic: str) -> None:
    """A node answers, and the services of another one are not known yet."""
    async with spinning(node):
        waiting = await Waiting.begin(world, topic)
        (info,) = world.ros.node.get_subscriptions_info_by_topic(topic)
        info.endpoint_gid = [1] * 16
        waiting.unknown = [info]
        await waiting.lasts()
        waiting.now = SETTLING_TIME
        await waiting.end()
