"""Goals between the robot's ROS and an environment, with fakes of both."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, cast

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from endpoints.bridge.config import RosAction
from endpoints.bridge.goals import CalledAction, OfferedAction
from endpoints.data.frames import Message, Phase
from endpoints.data.interface import error_of
from endpoints.environment.action_client import ActionClientInterface
from endpoints.environment.action_provider import ActionProviderInterface
from rce.client import Environment, GoalResult, ServerGoal
from rce.client.actions import ActionServer
from rce.client.stream import Stream
from rce.errors import Forbidden, Lost, NotFound, RceError
from tests.support.endpoints.fake_local_ros import NODE, FakeInterface, FakeLocalRos

TYPE = "test_msgs/Fibonacci"
WAIT = 60.0  # seconds


class FakeGoal:
    """Goal that an action server of the environment carries out."""

    def __init__(self) -> None:
        self.feedback: Stream[bytes] = Stream(100)
        self.refuses: RceError | None = None
        self.canceled = False
        self.ended: asyncio.Future[GoalResult] = asyncio.get_running_loop().create_future()

    def __aiter__(self) -> Any:
        return aiter(self.feedback)

    async def result(self) -> GoalResult:
        return await self.ended

    async def cancel(self, timeout: float) -> None:  # noqa: ASYNC109  # as the client's
        if self.refuses is not None:
            raise self.refuses
        self.canceled = True

    def end(self, result: GoalResult | RceError) -> None:
        if isinstance(result, RceError):
            self.ended.set_exception(result)
        else:
            self.ended.set_result(result)
        self.feedback.end()


class Sky:
    """Environment whose action servers and clients are a test's."""

    def __init__(self) -> None:
        self.opened: list[tuple[str, str]] = []
        self.accept: Callable[[bytes], Awaitable[bool]]
        self.carry_out: Callable[[ServerGoal], Awaitable[GoalResult]]
        self.sent: list[tuple[bytes, bool]] = []
        self.goal: asyncio.Future[FakeGoal] = asyncio.get_running_loop().create_future()

    def as_environment(self) -> Environment:
        return cast(Environment, self)

    async def action_server(self, action: str, type: str, handler: Any, *, accept: Any, raw: bool) -> None:
        assert raw
        self.opened.append((action, type))
        self.accept, self.carry_out = accept, handler

    async def action_client(self, action: str, type: str, *, raw: bool) -> Sky:
        assert raw
        self.opened.append((action, type))
        return self

    async def send_goal(self, request: bytes, **options: Any) -> FakeGoal:
        self.sent.append((request, options["cancel_if_lost"]))
        return await asyncio.shield(self.goal)


class Server:
    """Action server of the environment's interface: takes the feedback."""

    tag = "act"

    def __init__(self) -> None:
        self.feedback: list[bytes] = []

    def asked(self, request: bytes) -> ServerGoal:
        goal = ServerGoal(cast(ActionServer, self), "0" * 32, request)
        goal.publish_feedback = self.take  # type: ignore[method-assign]
        return goal

    def take(self, value: bytes) -> bool:
        self.feedback.append(value)
        return True


@pytest.fixture
async def sky() -> Sky:
    return Sky()


def say(there: FakeInterface, id: str, phase: Phase, payload: bytes = b"") -> None:
    """Let the robot's ROS send a message about a goal."""
    there.link.send(Message(NODE, id, payload, phase=phase), None)


async def told(there: FakeInterface, count: int) -> list[Message]:
    """Return what the bridge gave to the robot's ROS, once there are so many messages."""
    async with asyncio.timeout(WAIT):
        while len(there.received) < count:  # noqa: ASYNC110  # a list has no event
            await asyncio.sleep(0)
    return there.received


async def offered(local: FakeLocalRos, sky: Sky, **options: Any) -> tuple[OfferedAction, FakeInterface]:
    flow = OfferedAction(RosAction("/drive", TYPE, to="/rover/drive", **options))
    await flow.open(local, sky.as_environment())
    there = local.interfaces["/drive"]
    assert (there.make, sky.opened) == (ActionClientInterface, [("/rover/drive", TYPE)])
    return flow, there


async def accepted(sky: Sky, there: FakeInterface, request: bytes) -> str:
    """Let the robot's server accept a goal; return its id."""
    deciding = asyncio.ensure_future(sky.accept(request))
    asked = (await told(there, 1))[0]
    assert (asked.phase, asked.payload) == (Phase.GOAL, request)
    say(there, asked.msg_id, Phase.ACCEPTED)
    assert await deciding
    return asked.msg_id


async def test_robot_carries_out_goals_of_the_environment(local: FakeLocalRos, sky: Sky) -> None:
    _, there = await offered(local, sky)
    request, server = b"request", Server()
    id = await accepted(sky, there, request)
    work = asyncio.ensure_future(sky.carry_out(server.asked(request)))
    await asyncio.sleep(0)
    say(there, id, Phase.FEEDBACK, b"half")
    say(there, id, Phase.ABORTED, b"stuck")
    assert await work == GoalResult("aborted", b"stuck")
    assert server.feedback == [b"half"]
    say(there, id, Phase.FEEDBACK, b"late")
    assert server.feedback == [b"half"]


async def test_goal_that_the_robots_server_rejects_is_rejected(local: FakeLocalRos, sky: Sky) -> None:
    _, there = await offered(local, sky)
    for number, phase in enumerate((Phase.REJECTED, None)):
        deciding = asyncio.ensure_future(sky.accept(b"request"))
        id = (await told(there, number + 1))[-1].msg_id
        if phase is not None:
            say(there, id, phase)
            assert not await deciding
        else:
            there.fail(id, NotFound("there is no server"))
            with pytest.raises(NotFound):
                await deciding


async def test_goal_that_is_canceled_before_the_decision_is_canceled_at_the_robot(
    local: FakeLocalRos, sky: Sky
) -> None:
    _, there = await offered(local, sky)
    deciding = asyncio.ensure_future(sky.accept(b"request"))
    await told(there, 1)
    deciding.cancel()
    asked, canceled = await told(there, 2)
    assert (canceled.phase, canceled.msg_id) == (Phase.CANCEL, asked.msg_id)


async def test_canceled_goal_ends_as_the_robots_server_says(local: FakeLocalRos, sky: Sky) -> None:
    _, there = await offered(local, sky)
    request = b"request"
    id = await accepted(sky, there, request)
    goal = Server().asked(request)
    work = asyncio.ensure_future(sky.carry_out(goal))
    await asyncio.sleep(0)
    goal.canceled = True
    work.cancel()
    assert (await told(there, 2))[1].phase == Phase.CANCEL
    say(there, id, Phase.CANCEL)
    say(there, id, Phase.SUCCEEDED, b"done all the same")
    assert await work == GoalResult("succeeded", b"done all the same")


async def test_goal_whose_server_is_lost_fails(local: FakeLocalRos, sky: Sky) -> None:
    _, there = await offered(local, sky)
    request = b"request"
    id = await accepted(sky, there, request)
    work = asyncio.ensure_future(sky.carry_out(Server().asked(request)))
    await asyncio.sleep(0)
    there.fail(id, Lost("the server is gone"))
    with pytest.raises(Lost):
        await work


@pytest.mark.parametrize("cancel_if_lost", [True, False])
async def test_goals_go_on_at_the_end_of_the_bridge_unless_they_are_not_to(
    local: FakeLocalRos, sky: Sky, cancel_if_lost: bool
) -> None:
    flow, there = await offered(local, sky, cancel_if_lost=cancel_if_lost)
    await accepted(sky, there, b"request")
    flow.end()
    assert [each.phase for each in there.received[1:]] == [Phase.CANCEL] * cancel_if_lost
    assert local.interfaces == {}


async def called(local: FakeLocalRos, sky: Sky, **options: Any) -> tuple[CalledAction, FakeInterface]:
    flow = CalledAction(RosAction("/plan", TYPE, to="/cloud/plan", **options))
    await flow.open(local, sky.as_environment())
    there = local.interfaces["/cloud/plan"]
    assert (there.make, sky.opened) == (ActionProviderInterface, [("/plan", TYPE)])
    return flow, there


async def test_node_of_robot_uses_action_of_the_environment(local: FakeLocalRos, sky: Sky) -> None:
    _, there = await called(local, sky, cancel_if_lost=True)
    goal = FakeGoal()
    sky.goal.set_result(goal)
    say(there, "7", Phase.GOAL, b"request")
    await told(there, 1)
    assert sky.sent == [(b"request", True)]
    goal.feedback.put(b"half")
    goal.end(GoalResult("succeeded", b"whole"))
    found = [(each.msg_id, each.phase, each.payload) for each in await told(there, 3)]
    assert found == [
        ("7", Phase.ACCEPTED, b""),
        ("7", Phase.FEEDBACK, b"half"),
        ("7", Phase.SUCCEEDED, b"whole"),
    ]


async def test_refusals_reach_the_node(local: FakeLocalRos, sky: Sky) -> None:
    _, there = await called(local, sky)
    sky.goal.set_exception(Forbidden("rejected the goal"))
    say(there, "7", Phase.GOAL)
    assert (await told(there, 1))[0].phase == Phase.REJECTED
    sky.goal = asyncio.get_running_loop().create_future()
    sky.goal.set_exception(NotFound("no such server"))
    say(there, "8", Phase.GOAL)
    answer = (await told(there, 2))[1]
    assert (answer.error, str(error_of(answer))) == (True, "no such server")


async def test_node_cancels_its_goal(local: FakeLocalRos, sky: Sky) -> None:
    _, there = await called(local, sky)
    goal = FakeGoal()
    sky.goal.set_result(goal)
    say(there, "7", Phase.GOAL)
    await told(there, 1)
    goal.refuses = Forbidden("it does not cancel")
    say(there, "7", Phase.CANCEL)
    refused = (await told(there, 2))[1]
    assert (refused.phase, refused.error) == (Phase.CANCEL, True)
    goal.refuses = None
    say(there, "7", Phase.CANCEL)
    assert (await told(there, 3))[2].phase == Phase.CANCEL
    goal.end(GoalResult("canceled", b""))
    assert (await told(there, 4))[3].phase == Phase.CANCELED
    say(there, "7", Phase.CANCEL)  # too late
    assert len(there.received) == 4


async def test_end_of_the_bridge_ends_goals_that_are_not_decided(local: FakeLocalRos, sky: Sky) -> None:
    flow, there = await called(local, sky)
    say(there, "7", Phase.GOAL)
    await asyncio.sleep(0)
    say(there, "7", Phase.CANCEL)  # the node has given up
    flow.end()
    assert there.received == []
    assert local.interfaces == {}
