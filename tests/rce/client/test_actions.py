"""Action clients and action servers, joined without a platform."""

from __future__ import annotations

import asyncio
from typing import Any, cast

import msgspec
import pytest

from rce.client import ActionClient, ActionServer, GoalResult, ServerGoal
from rce.client.connection import Connection, Message
from rce.client.interface import Interface, Owner
from rce.errors import Forbidden, Lost, NotFound, RceError, TimedOut, Unavailable
from rce.protocol.messages import DataMessage

TYPE = "example_interfaces/Fibonacci"


class Side:
    """Robot of an interface, whose messages go to `other` while it is online."""

    name = "robot"

    def __init__(self) -> None:
        self.online = True
        self.other: Interface
        self.sent: list[DataMessage] = []

    @property
    def connection(self) -> Connection | None:
        return cast(Connection, self) if self.online else None

    def room(self, tag: str) -> None:
        return None

    def put_message(self, tag: str, text: bytes, blobs: dict[str, Any]) -> None:
        data = msgspec.json.decode(text)["data"]
        message = msgspec.json.decode(msgspec.json.encode({"msg": {}} | data), type=DataMessage)
        self.sent.append(message)
        asyncio.get_running_loop().call_soon(self._deliver, message)

    def _deliver(self, message: DataMessage) -> None:
        if message.error:  # the platform sends these as errors
            more = {"phase": "cancel"} if message.phase == "cancel" else {}
            self.other._fail_call(RceError(message.error).with_fields(**more), message.msgID)
        else:
            self.other._receive(Message(message, {}))

    def phases(self) -> list[str]:
        return [each.phase for each in self.sent]


class World:
    """A client and a server of an action; the server carries out goals by `work`."""

    def __init__(self) -> None:
        self.asker, self.worker = Side(), Side()
        self.client = ActionClient(cast(Owner, self.asker), "ask", TYPE)
        self.server = ActionServer(cast(Owner, self.worker), "act", TYPE, self.handle, lambda goal: goal["order"] >= 0)
        self.asker.other, self.worker.other = self.server, self.client
        self.begun: list[ServerGoal] = []
        for interface in (self.client, self.server):
            interface._set_status(True)

    async def handle(self, goal: ServerGoal) -> Any:
        self.begun.append(goal)
        order = goal.request["order"]
        if order == 99:
            raise ValueError("too many")
        if order == 0:
            try:
                await asyncio.Event().wait()
            except asyncio.CancelledError:
                return {"sequence": [9]}
        if order == 1:
            await asyncio.Event().wait()
        for number in range(order):
            goal.publish_feedback({"sequence": [number]})
            await asyncio.sleep(0)
        return {"sequence": list(range(order))}


@pytest.fixture
async def world() -> World:
    return World()


async def settled() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


async def test_goal_gives_feedback_and_result(world: World) -> None:
    goal = await world.client.send_goal({"order": 3})
    assert [each["sequence"] async for each in goal] == [[0], [1], [2]]
    assert await goal.result() == GoalResult("succeeded", {"sequence": [0, 1, 2]})


async def test_rejected_goal_raises(world: World) -> None:
    with pytest.raises(Forbidden, match="rejected the goal"):
        await world.client.send_goal({"order": -1})
    assert world.begun == []


@pytest.mark.parametrize("decision", [True, False])
async def test_goal_is_decided_upon_by_a_coroutine(world: World, decision: bool) -> None:
    async def decide(_: Any) -> bool:
        await asyncio.sleep(0)
        return decision

    world.server._accept = decide
    if decision:
        assert (await (await world.client.send_goal({"order": 3})).result()).status == "succeeded"
    else:
        with pytest.raises(Forbidden, match="rejected the goal"):
            await world.client.send_goal({"order": 3})


@pytest.mark.parametrize("error", [NotFound("no server"), ValueError("wrong")])
async def test_goal_is_rejected_if_its_decision_fails(world: World, error: Exception) -> None:
    async def fail(_: Any) -> bool:
        raise error

    world.server._accept = fail
    with pytest.raises(Forbidden):
        await world.client.send_goal({"order": 3})


async def test_goal_that_is_canceled_while_it_is_decided_upon_is_rejected(world: World) -> None:
    async def never(_: Any) -> bool:
        await asyncio.Event().wait()
        return True

    world.server._accept = never
    sending = asyncio.ensure_future(world.client.send_goal({"order": 3}))
    await settled()
    world.client._send(world.asker.sent[0].msgID, "cancel")
    with pytest.raises(Forbidden):
        await sending
    assert world.worker.phases() == ["cancel", "rejected"]
    assert world.begun == []


async def test_handler_may_say_how_the_goal_ended(world: World) -> None:
    async def abort(_: ServerGoal) -> GoalResult:
        return GoalResult("aborted", {"sequence": [7]})

    world.server._handler = abort
    goal = await world.client.send_goal({"order": 3})
    assert await goal.result() == GoalResult("aborted", {"sequence": [7]})


@pytest.mark.parametrize(("order", "value"), [(0, {"sequence": [9]}), (1, {})])
async def test_canceled_goal_ends_with_what_the_handler_returns(world: World, order: int, value: Any) -> None:
    goal = await world.client.send_goal({"order": order})
    await settled()
    await goal.cancel()
    assert await goal.result() == GoalResult("canceled", value)
    assert world.begun[0].canceled


async def test_goal_that_is_canceled_before_its_handler_has_begun_ends(world: World) -> None:
    goal = await world.client.send_goal({"order": 0})
    await goal.cancel()
    assert (await goal.result()).status == "canceled"


async def test_exception_of_the_handler_fails_the_goal(world: World) -> None:
    goal = await world.client.send_goal({"order": 99})
    with pytest.raises(RceError, match="ValueError: too many"):
        await goal.result()
    assert world.worker.sent[-1].status == "aborted"


async def test_goal_that_has_ended_cannot_be_canceled(world: World) -> None:
    goal = await world.client.send_goal({"order": 2})
    await goal.result()
    with pytest.raises(NotFound, match="has ended"):
        await goal.cancel()


async def test_undecided_goal_is_canceled(world: World) -> None:
    world.asker.other = Interface(cast(Owner, world.worker), "nobody", TYPE)
    with pytest.raises(TimedOut):
        await world.client.send_goal({"order": 2}, timeout=0.01)
    assert world.asker.phases() == ["goal", "cancel"]


async def test_lost_server_fails_the_goal(world: World) -> None:
    goal = await world.client.send_goal({"order": 0})
    world.client._fail_call(Lost("the server is gone"), goal.id)
    with pytest.raises(Lost):
        await goal.result()
    assert [each async for each in goal] == []


async def test_robot_that_is_back_asks_for_results(world: World) -> None:
    goal = await world.client.send_goal({"order": 0})
    world.asker.online = False
    world.client._disconnected()
    assert not goal._result.done(), "the goal goes on"
    world.asker.online = True
    world.client._set_status(True)
    assert world.asker.phases() == ["goal", "result"]


async def test_result_waits_until_the_server_is_back(world: World) -> None:
    goal = await world.client.send_goal({"order": 2})
    world.worker.online = False
    world.server._disconnected()
    await settled()
    assert "result" not in world.worker.phases()
    world.worker.online = True
    world.server._set_status(True)
    assert (await goal.result(5)).status == "succeeded"


async def test_closed_client_ends_its_goals(world: World) -> None:
    goal = await world.client.send_goal({"order": 0})
    world.client._end(None)
    with pytest.raises(Unavailable):
        await goal.result()


async def test_goal_is_leased_if_wanted(world: World) -> None:
    await world.client.send_goal({"order": 0}, cancel_if_lost=True)
    assert world.asker.sent[0].ifLost == "cancel"
