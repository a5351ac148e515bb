"""Listeners of ROS entities, with real ROS 2."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, cast

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from rclpy.duration import Duration
from rclpy.event_handler import QoSSubscriptionEventType
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from std_msgs.msg import String
from twisted.logger import LogEvent

from endpoints.environment import ros_listener
from endpoints.environment.ros_listener import Listener
from tests.support.endpoints.ros_world import LIMIT, RosWorld

if TYPE_CHECKING:
    from endpoints.environment.ros_listener import Entity

TOPIC = "/listened"
PAUSE = 0.05  # seconds in which nothing may happen


class Ears:
    """A listener of a subscription. Its action takes one message, and `heard` counts its calls."""

    def __init__(self, world: RosWorld) -> None:
        self.heard = 0
        self.taken: list[str] = []
        self.changed = asyncio.Event()
        self.publisher: Publisher[String] = world.other.create_publisher(String, TOPIC, 100)
        self.subscription: Subscription[String] = world.ros.node.create_subscription(String, TOPIC, print, 100)
        self.listeners: list[Listener] = []

    def listen(self, *entities: Entity) -> Listener:
        """Return a listener to entities, or to the subscription."""
        entities = entities or (self.subscription.handle,)
        self.listeners.append(Listener(asyncio.get_running_loop(), self._hear, entities))
        return self.listeners[-1]

    def _hear(self) -> None:
        self.heard += 1
        found = self.subscription.handle.take_message(String, False)
        if found is not None:
            self.taken.append(found[0].data)
        self.changed.set()

    async def matched(self) -> None:
        """Wait until a message would arrive."""
        async with asyncio.timeout(LIMIT):
            while not (self.publisher.get_subscription_count() and self.subscription.get_publisher_count()):  # noqa: ASYNC110
                await asyncio.sleep(0.01)

    async def until(self, count: int) -> None:
        """Wait until the action has run `count` times."""
        async with asyncio.timeout(LIMIT):
            while self.heard < count:
                self.changed.clear()
                await self.changed.wait()


@pytest.fixture
async def ears(world: RosWorld) -> AsyncIterator[Ears]:
    found = Ears(world)
    yield found
    for listener in found.listeners:
        listener.close()
    world.ros.node.destroy_subscription(found.subscription)
    world.other.destroy_publisher(found.publisher)


async def test_action_runs_for_messages_and_again_for_those_that_it_left(ears: Ears) -> None:
    listener = ears.listen()
    await ears.matched()
    for number in range(3):
        ears.publisher.publish(String(data=str(number)))
    while len(ears.taken) < 3:
        await ears.until(ears.heard + 1)
        listener.again()
    assert ears.taken == ["0", "1", "2"]


async def test_messages_that_came_before_the_listener_run_it(ears: Ears) -> None:
    await ears.matched()
    ears.publisher.publish(String(data="early"))
    assert ears.publisher.wait_for_all_acked(Duration(seconds=LIMIT))  # it has arrived
    ears.listen()
    await ears.until(1)
    assert ears.taken == ["early"]


async def test_paused_listener_runs_for_what_came_meanwhile(ears: Ears) -> None:
    listener = ears.listen()
    await ears.matched()
    listener.pause()
    ears.publisher.publish(String(data="meanwhile"))
    await asyncio.sleep(PAUSE)
    assert not ears.heard
    listener.resume()
    await ears.until(1)
    assert ears.taken == ["meanwhile"]


async def test_closed_listener_does_not_run_and_uses_no_descriptor(ears: Ears) -> None:
    listener = ears.listen()
    listener.close()
    reader, writer = os.pipe()  # one of them has the number that the listener's descriptor had
    os.write(writer, b"12345678")
    for method in (listener.resume, listener.run, listener.again, listener.pause, listener.close):
        method()
    assert os.read(reader, 100) == b"12345678"
    os.close(reader)
    os.close(writer)
    await ears.matched()
    ears.publisher.publish(String(data="unheard"))
    await asyncio.sleep(PAUSE)
    assert not ears.heard


async def test_run_does_nothing_while_nothing_has_come(ears: Ears) -> None:
    listener = ears.listen()
    listener.run()
    assert not ears.heard
    listener.again()
    listener.run()
    assert ears.heard == 1
    await asyncio.sleep(PAUSE)
    assert ears.heard == 1


async def test_events_run_it(ears: Ears) -> None:
    ears.listen(_rclpy.EventHandle(ears.subscription.handle, QoSSubscriptionEventType.RCL_SUBSCRIPTION_MATCHED))
    await ears.matched()
    await ears.until(1)


async def test_defect_in_its_action_is_logged(world: RosWorld, failures: list[LogEvent]) -> None:
    def fail() -> None:
        raise ZeroDivisionError

    listener = Listener(asyncio.get_running_loop(), fail, ())
    listener.again()
    listener.run()
    assert len(failures) == 1
    failures.clear()
    listener.close()


async def test_listener_that_ros_refuses_is_an_error(ears: Ears) -> None:
    class Broken:
        pointer = 0

    ros_listener._ATTACH[Broken] = ros_listener._ATTACH[type(ears.subscription.handle)]
    try:
        with pytest.raises(RuntimeError, match="does not take a listener of a Broken"):
            ears.listen(cast("Entity", Broken()))
    finally:
        del ros_listener._ATTACH[Broken]
