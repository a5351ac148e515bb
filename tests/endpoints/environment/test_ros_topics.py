"""Paused subscriptions, with real ROS 2."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import pytest

from tests.support.domains import domain

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from rclpy.context import Context  # noqa: E402  # after importorskip
from std_msgs.msg import String  # noqa: E402

from endpoints.environment.ros import Ros  # noqa: E402
from endpoints.environment.ros_listener import Listener  # noqa: E402
from endpoints.environment.ros_topics import RawSubscription, Taken, Topic  # noqa: E402
from rce.protocol.messages import Qos  # noqa: E402

if TYPE_CHECKING:
    from endpoints.environment.ros_listener import Entity

MAX_TURNS = 50


class CountingRos(Ros):
    """Counts how often listeners run."""

    turns = 0

    def listen(self, action: Callable[[], None], *entities: Entity) -> Listener:
        def counted() -> None:
            self.turns += 1
            action()

        return super().listen(counted, *entities)


async def test_messages_left_in_middleware_do_not_wake_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain("resting")))
    context = Context()
    rclpy.init(context=context, args=[])
    node = rclpy.create_node("speaker", context=context)
    publisher = node.create_publisher(String, "said", 10)
    ros = CountingRos("endpoint")
    received: asyncio.Queue[bytes] = asyncio.Queue()

    def take(batch: Sequence[Taken]) -> bool:
        for payload, _ in batch:
            received.put_nowait(payload)
        return True

    try:
        report: Callable[[str], None] = print
        subscription = RawSubscription(ros, Topic(String, "/said", Qos(), report), take, print)
        while not publisher.get_subscription_count():  # noqa: ASYNC110  # rclpy has an event for executors only
            await asyncio.sleep(0.01)
        subscription.start()
        publisher.publish(String(data="heard"))
        await asyncio.wait_for(received.get(), 60)
        subscription.pause()
        for _ in range(5):
            publisher.publish(String(data="left"))
        before = ros.turns
        await asyncio.sleep(0.1)  # a busy loop makes thousands of turns in this time
        assert ros.turns - before < MAX_TURNS
        subscription.resume()
        assert b"left" in await asyncio.wait_for(received.get(), 60)
    finally:
        ros.close()
        node.destroy_node()
        context.try_shutdown()
