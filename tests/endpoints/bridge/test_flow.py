"""Base of flows: its interface in the robot's ROS."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from endpoints.bridge.flow import Flow
from endpoints.bridge.local_ros import CLOUD, LocalRos
from endpoints.data.frames import Message
from endpoints.environment.topics import PublisherInterface
from rce.client import Environment
from tests.support.endpoints.fake_local_ros import FakeLocalRos


class Plain(Flow):
    async def open(self, local: LocalRos, environment: Environment | None) -> None:
        await self.add_local_interface(local, PublisherInterface, "std_msgs/String", "/a")


async def test_what_is_delivered_while_the_flow_is_open_is_counted(local: FakeLocalRos) -> None:
    flow, message = Plain(), Message(CLOUD, "", b"four")
    flow.deliver(message)
    await flow.open(local, None)
    there = local.interfaces["/a"]
    flow.deliver(message)
    flow.end()
    flow.deliver(message)
    assert there.received == [message]
    assert there.traffic.of(CLOUD).bytes == 4
