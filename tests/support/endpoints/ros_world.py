"""A ROS node, and a node of another process for it, in a ROS domain of their own."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import rclpy
from rclpy.context import Context
from rclpy.node import Node

from endpoints.environment.ros import Ros
from tests.support.domains import domain

NODE = "tested_endpoint"
LIMIT = 60.0  # seconds until a test gives up


class RosWorld:
    """The node, and `other`: one that it does not know, which has a context of its own."""

    def __init__(self, ros: Ros, other: Node) -> None:
        self.ros = ros
        self.other = other

    async def until(self, condition: Callable[[], bool]) -> None:
        """Wait for a condition for which ROS has no event."""
        async with asyncio.timeout(LIMIT):
            while not condition():  # noqa: ASYNC110
                await asyncio.sleep(0.01)


@asynccontextmanager
async def ros_world() -> AsyncIterator[RosWorld]:
    """Run both. The variables of ROS 2 must limit discovery to this machine."""
    number = domain("ros world")
    context = Context()
    rclpy.init(context=context, args=[], domain_id=number)
    other = rclpy.create_node("other", context=context, enable_rosout=False, start_parameter_services=False)
    ros = Ros(NODE)
    try:
        yield RosWorld(ros, other)
    finally:
        ros.close()
        other.destroy_node()
        context.try_shutdown()
