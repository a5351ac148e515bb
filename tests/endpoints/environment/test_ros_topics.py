"""Paused subscriptions, with real ROS 2."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from functools import partial

import pytest

from tests.support.domains import domain

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from rclpy.context import Context  # noqa: E402  # after importorskip
from std_msgs.msg import String  # noqa: E402

from endpoints.environment.ros import RosThread  # noqa: E402
from endpoints.environment.ros_topics import RawSubscription, Taken, Topic  # noqa: E402
from rce.protocol.messages import Qos  # noqa: E402

MAX_TURNS = 50


class CountingThread(RosThread):
    turns = 0

    def _run_posted(self) -> None:
        self.turns += 1
        super()._run_posted()


async def test_messages_left_in_middleware_do_not_wake_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain("resting")))
    context = Context()
    rclpy.init(context=context, args=[])
    node = rclpy.create_node("speaker", context=context)
    publisher = node.create_publisher(String, "said", 10)
    ros = CountingThread(asyncio.get_running_loop(), "endpoint")
    await ros.start()
    received: asyncio.Queue[bytes] = asyncio.Queue()

    def take(batch: Sequence[Taken]) -> bool:
        for payload, _ in batch:
            ros.deliver(partial(received.put_nowait, payload))
        return True

    try:
        report: Callable[[str], None] = print
        subscription = await ros.run(lambda: RawSubscription(ros, Topic(String, "/said", Qos(), report), take, print))
        while not publisher.get_subscription_count():  # noqa: ASYNC110  # rclpy has an event for executors only
            await asyncio.sleep(0.01)
        ros.post(subscription.start)
        publisher.publish(String(data="heard"))
        await asyncio.wait_for(received.get(), 60)
        await ros.run(subscription.pause)
        for _ in range(5):
            publisher.publish(String(data="left"))
        before = ros.turns
        await asyncio.sleep(0.1)  # a busy thread makes thousands of turns in this time
        assert ros.turns - before < MAX_TURNS
        ros.post(subscription.resume)
        assert b"left" in await asyncio.wait_for(received.get(), 60)
    finally:
        await ros.stop()
        node.destroy_node()
        context.try_shutdown()
