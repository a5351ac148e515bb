"""A ROS thread, and a node of another process for it, in a ROS domain of their own."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import rclpy
from rclpy.context import Context
from rclpy.node import Node

from endpoints.environment.ros import RosThread
from tests.support.domains import domain

NODE = "tested_endpoint"
LIMIT = 60.0  # seconds until a test gives up


class RosWorld:
    """The thread, and `other`: a node that it does not know, which has a context of its own."""

    def __init__(self, ros: RosThread, other: Node) -> None:
        self.ros = ros
        self.other = other

    async def until(self, condition: Callable[[], bool]) -> None:
        """Wait for a condition of the ROS thread for which ROS has no event."""
        async with asyncio.timeout(LIMIT):
            while not await self.ros.run(condition):  # noqa: ASYNC110
                await asyncio.sleep(0.01)


@asynccontextmanager
async def ros_world() -> AsyncIterator[RosWorld]:
    """Run both. The variables of ROS 2 must limit discovery to this machine."""
    number = domain("ros world")
    context = Context()
    rclpy.init(context=context, args=[], domain_id=number)
    other = rclpy.create_node("other", context=context, enable_rosout=False, start_parameter_services=False)
    ros = RosThread(asyncio.get_running_loop(), NODE)
    try:
        await ros.start()
        yield RosWorld(ros, other)
    finally:
        await ros.stop()
        other.destroy_node()
        context.try_shutdown()
