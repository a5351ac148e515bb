"""Questions of Robot endpoints, within the rights of who opened the session of the robot that asks."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from master.access.robot_questions import RobotQuestions
from master.graph.records import Environment, Process
from rce.api.roles import Principal, Scopes
from rce.control.calls.robots import Definitions, DescribeType, ReadAssetFor, ReadGraphFor, ReadRobotsFor
from rce.control.calls.watching import Asset, ReadAsset, ReadGraph, RosGraph
from rce.control.connection import Handlers
from rce.errors import NotFound, UnknownType
from rce.protocol import messages as m
from tests.support.control import answer
from tests.support.master.fleet import Fleet, interface, wired


class Site:
    """A platform in memory, whose environments answer at once, and a Robot endpoint that asks."""

    def __init__(self) -> None:
        self.fleet: Fleet = wired()
        self.asked: list[tuple[str, Any]] = []
        self.refuses = False
        self.questions = RobotQuestions(self.fleet.state, self._ask)

    async def _ask(self, environment: Environment, call: Any) -> Any:
        self.asked.append((environment.name, call))
        if self.refuses:
            raise UnknownType("not here")
        if isinstance(call, ReadGraph):
            return RosGraph([], [])
        return Asset(b"mesh", 4) if isinstance(call, ReadAsset) else Definitions({"a/msg/B": "int8 x"})

    def process(self, name: str = "west") -> Process:
        return self.fleet.state.processes[name]

    def open_as(self, robot: str, principal: Principal) -> None:
        """Say who opened the session of a robot."""
        robots = self.fleet.state.robots
        robots.put(replace(robots[robot], principal=principal))

    async def call(self, call: Any, endpoint: str = "west") -> Any:
        handlers = Handlers()
        self.questions.add_handlers(handlers, self.process(endpoint))
        return await answer(handlers, call)


@pytest.fixture
def site() -> Site:
    made = Site()
    made.open_as("ann/r1", Principal("ann", "user"))
    return made


async def test_graph_and_files_come_from_the_environment(site: Site) -> None:
    assert await site.call(ReadGraphFor("ann/r1", "brain")) == RosGraph([], [])
    assert await site.call(ReadAssetFor("ann/r1", "brain", "arm", "meshes/hand.stl", 7)) == Asset(b"mesh", 4)
    assert site.asked == [("ann/brain", ReadGraph()), ("ann/brain", ReadAsset("arm", "meshes/hand.stl", 7))]


async def test_robot_of_another_endpoint_does_not_ask(site: Site) -> None:
    site.fleet.join("east", "robot")
    for call in (ReadGraphFor("ann/r1", "brain"), ReadRobotsFor("ann/r1")):
        with pytest.raises(NotFound, match="robot ann/r1 has no session at east"):
            await site.call(call, "east")
    assert site.asked == []


async def test_environment_of_another_user_and_one_out_of_scope_are_not_there(site: Site) -> None:
    site.open_as("bob/r1", Principal("bob", "user"))
    with pytest.raises(NotFound, match="there is no environment 'brain'"):
        await site.call(ReadGraphFor("bob/r1", "brain"))
    site.open_as("ann/r1", Principal("ann", "user", scopes=Scopes(environments=["other"])))
    with pytest.raises(NotFound):
        await site.call(ReadGraphFor("ann/r1", "brain"))
    assert site.asked == []


async def test_interfaces_of_all_robots_of_the_owner_are_listed_but_not_those_of_guests(site: Site) -> None:
    site.fleet.robot("ann/r2")
    site.fleet.robot("ann/@desk")
    site.fleet.do("ann", interface("r2", "voice", "SubscriberConverter"))
    found = (await site.call(ReadRobotsFor("ann/r1"))).interfaces
    assert [(each.robot, each.tag) for each in found] == [("r1", "pose"), ("r2", "voice")]


async def test_tied_key_lists_its_own_robot_only(site: Site) -> None:
    site.fleet.robot("ann/r2")
    site.fleet.do("ann", interface("r2", "voice", "SubscriberConverter"))
    site.open_as("ann/r1", Principal("ann", "user", scopes=Scopes(robot="r1")))
    found = (await site.call(ReadRobotsFor("ann/r1"))).interfaces
    assert [each.robot for each in found] == ["r1"]


async def test_type_is_described_by_the_first_environment_that_knows_it(site: Site) -> None:
    site.fleet.do("ann", m.CreateContainer("other"))
    call = DescribeType("ann", "a/msg/B", "msg")
    assert (await site.call(call)).texts == {"a/msg/B": "int8 x"}
    site.refuses = True
    with pytest.raises(UnknownType, match="neither here nor in an environment of ann"):
        await site.call(call)
    assert [name for name, _ in site.asked] == ["ann/brain", "ann/brain", "ann/other"]
