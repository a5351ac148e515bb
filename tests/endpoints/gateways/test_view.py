"""What a guest sees of its environment, with a fake of the Master."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from endpoints.gateways.changes import Changes
from endpoints.gateways.graphs import Graphs
from endpoints.gateways.view import View
from endpoints.robot.endpoint import RobotEndpoint
from rce.control.calls.robots import ReadAssetFor, ReadGraphFor, RobotInterfaceName, RobotInterfaces
from rce.control.calls.watching import Asset, RosGraph, RosName
from rce.errors import InvalidRequest

FILE = b"0123456789"
CHAT = RosName("/rover/chat", ["std_msgs/msg/String"], 1, 0)


class Master:
    def __init__(self) -> None:
        self.graph = RosGraph([], [])
        self.robots: list[RobotInterfaceName] = []
        self.asked: list[type[Any]] = []

    async def call(self, call: Any) -> Any:
        self.asked.append(type(call))
        if isinstance(call, ReadGraphFor):
            return self.graph
        if isinstance(call, ReadAssetFor):
            return Asset(FILE[call.offset : call.offset + 4], len(FILE))
        return RobotInterfaces(self.robots)


@pytest.fixture
def master() -> Master:
    return Master()


@pytest.fixture
def view(master: Master) -> View:
    endpoint = cast(RobotEndpoint, SimpleNamespace(master=master))
    made = View(endpoint, Graphs(), "brain", Changes())
    made.name = "ann/@rosbridge_1"
    return made


async def test_environment_and_robots_are_asked_once_in_a_while(master: Master, view: View) -> None:
    for _ in range(3):
        await view.graph()
    assert len(master.asked) == 2
    await view.graph(age=0)
    assert len(master.asked) == 4


async def test_interface_of_a_robot_is_used_unless_the_environment_has_its_name(master: Master, view: View) -> None:
    master.robots = [RobotInterfaceName("rover", "chat", "SubscriberConverter", "std_msgs/String")]
    assert await view.robot_interface("/rover/chat", "SubscriberInterface") == "rover/chat"
    assert await view.robot_interface("/rover/chat", "PublisherInterface") == ""
    assert await view.robot_interface("/chat", "SubscriberInterface") == ""
    master.graph = RosGraph([CHAT], [])
    await view.graph(age=0)
    assert await view.robot_interface("/rover/chat", "SubscriberInterface") == ""


async def test_file_of_a_package_is_read_in_pieces(view: View) -> None:
    assert await view.asset("package://maps/a%20b.pgm") == FILE
    for uri in ("file:///etc/passwd", "package://maps", "package://", "maps/a"):
        with pytest.raises(InvalidRequest, match="only files of packages"):
            await view.asset(uri)
