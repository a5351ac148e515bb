"""A subscription that nobody listens to, with real ROS 2."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest
from domains import domain

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from rclpy.context import Context  # noqa: E402  (ROS is imported only where it is there)
from std_msgs.msg import String  # noqa: E402

from endpoints.environment.ros import RosThread  # noqa: E402
from endpoints.environment.ros_topics import RawSubscription  # noqa: E402
from rce.messages import Qos  # noqa: E402

TURNS = 50


class CountingThread(RosThread):
    turns = 0

    def _work(self) -> None:
        self.turns += 1
        super()._work()


async def test_messages_that_are_left_there_do_not_keep_the_thread_awake(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain("resting")))
    context = Context()
    rclpy.init(context=context, args=[])
    node = rclpy.create_node("speaker", context=context)
    speaker = node.create_publisher(String, "said", 10)
    ros = CountingThread(asyncio.get_running_loop(), "endpoint")
    await ros.start()
    heard: asyncio.Queue[bytes] = asyncio.Queue()

    def take(payload: bytes, publisher: bytes) -> bool:
        ros.deliver(lambda: heard.put_nowait(payload))
        return True

    try:
        complain: Callable[[str], None] = print
        listener = await ros.run(lambda: RawSubscription(ros, String, "/said", Qos(), complain, take))
        while not speaker.get_subscription_count():  # noqa: ASYNC110  # rclpy announces it to executors only
            await asyncio.sleep(0.01)
        ros.post(listener.start)
        speaker.publish(String(data="heard"))
        await asyncio.wait_for(heard.get(), 10)
        await ros.run(listener.rest)
        for _ in range(5):
            speaker.publish(String(data="left"))
        before = ros.turns
        await asyncio.sleep(0.1)  # a thread that does not sleep makes thousands of turns in this time
        assert ros.turns - before < TURNS
        ros.post(listener.resume)
        assert b"left" in await asyncio.wait_for(heard.get(), 10)
    finally:
        await ros.stop()
        node.destroy_node()
        context.try_shutdown()
