"""ROS 2 actions between robots and a node, with robots and nodes that are killed."""

from __future__ import annotations

import asyncio
import os
import signal
from base64 import b64decode
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from rce.client import ActionClient, Environment, Reconnected, Robot, ServerGoal
from rce.errors import Forbidden, Lost, NotFound, TimedOut
from tests.support.e2e.consoles import rce, running, user_environ
from tests.support.e2e.real_platform import RealPlatform

pytest.importorskip("test_msgs", reason="needs ros-test-msgs")

TYPE = "test_msgs/Fibonacci"
ENDLESS, REJECTED = 0, -1
EXECUTING, CANCELED = 2, 5  # of action_msgs/GoalStatus
WAIT = 60.0  # seconds
FIRST_8 = [0, 1, 1, 2, 3, 5, 8, 13]


class World(NamedTuple):
    robot: Robot
    environment: Environment
    client: ActionClient


@pytest.fixture(scope="module")
async def world(platform: RealPlatform) -> AsyncIterator[World]:
    """A robot that asks a node for Fibonacci numbers."""
    async with platform.robot("fibonacci") as robot, robot.environment("fibonacci_world") as environment:
        await environment.add_node("server", "Relay", "fibonacci.py")
        client = await environment.action_client("/fibonacci", TYPE)
        await wait_for_server(client)
        yield World(robot, environment, client)


async def wait_for_server(client: ActionClient) -> None:
    """Send goals until one gets feedback: answers and feedback are lost until DDS discovery has finished."""
    async with asyncio.timeout(120):
        while True:
            with suppress(NotFound, TimedOut):
                goal = await client.send_goal({"order": 8}, timeout=5)
                if [each async for each in goal]:
                    return


async def test_goal_of_a_robot_gets_feedback_and_result(world: World) -> None:
    goal = await world.client.send_goal({"order": 8}, timeout=WAIT)
    feedback = [each["sequence"] async for each in goal]
    assert feedback[-1] == FIRST_8
    assert await goal.result() == ("succeeded", {"sequence": FIRST_8})


async def test_goal_is_rejected(world: World) -> None:
    with pytest.raises(Forbidden, match="rejected"):
        await world.client.send_goal({"order": REJECTED}, timeout=WAIT)


async def test_goal_is_canceled_while_it_runs_and_not_after_its_end(world: World) -> None:
    goal = await world.client.send_goal({"order": ENDLESS}, timeout=WAIT)
    await goal.feedback.get(WAIT)
    await goal.cancel(WAIT)
    assert (await goal.result(WAIT)).status == "canceled"
    with pytest.raises(NotFound, match="has ended"):
        await goal.cancel(WAIT)


async def test_hundred_goals_at_once(world: World) -> None:
    sending = (world.client.send_goal({"order": 8}, timeout=WAIT) for _ in range(100))
    goals = await asyncio.gather(*sending)
    results = await asyncio.gather(*(goal.result(WAIT) for goal in goals))
    assert [each.value["sequence"] for each in results] == [FIRST_8] * 100


async def test_robot_that_was_offline_gets_its_result(world: World) -> None:
    goal = await world.client.send_goal({"order": ENDLESS}, timeout=WAIT)
    assert world.robot.connection is not None
    events = world.robot.events()
    world.robot.connection._websocket.abort()
    while not isinstance(await events.get(WAIT), Reconnected):
        pass
    await goal.cancel(WAIT)
    assert (await goal.result(WAIT)).status == "canceled"


async def test_goal_ends_with_its_robot_if_it_is_to(platform: RealPlatform, world: World) -> None:
    status = await world.environment.subscriber("/fibonacci/_action/status", "action_msgs/GoalStatusArray")
    async with platform.robot("visitor") as visitor:
        client = await visitor.environment("fibonacci_world").action_client("/fibonacci", TYPE)
        left = await client.send_goal({"order": ENDLESS}, timeout=WAIT)
        leased = await client.send_goal({"order": ENDLESS}, timeout=WAIT, cancel_if_lost=True)
    found = dict[str, int]()
    while found.get(leased.id) != CANCELED:
        for each in (await status.get(WAIT))["status_list"]:
            found[b64decode(each["goal_info"]["goal_id"]["uuid"]).hex()] = each["status"]
    assert found[left.id] == EXECUTING
    await status.close()


async def test_robot_carries_out_the_goals_of_another_robot_through_ros(platform: RealPlatform, world: World) -> None:
    async def work(goal: ServerGoal) -> dict[str, Any]:
        if goal.request["order"] == ENDLESS:
            await asyncio.Event().wait()
        goal.publish_feedback({"sequence": [1]})
        return {"sequence": [1, 2]}

    async with platform.robot("worker") as worker:
        environment = worker.environment("fibonacci_world")
        await environment.action_server("/work", TYPE, work, accept=lambda goal: bool(goal["order"] >= 0))
        client = await world.environment.action_client("/work", TYPE)
        done = await client.send_goal({"order": 3}, timeout=WAIT)
        assert await done.result(WAIT) == ("succeeded", {"sequence": [1, 2]})
        assert [each async for each in done] == [{"sequence": [1]}]
        with pytest.raises(Forbidden):
            await client.send_goal({"order": REJECTED}, timeout=WAIT)
        canceled = await client.send_goal({"order": ENDLESS}, timeout=WAIT)
        await canceled.cancel(WAIT)
        assert (await canceled.result(WAIT)).status == "canceled"
        lost = await client.send_goal({"order": ENDLESS}, timeout=WAIT)
    assert (await lost.result(WAIT)).status == "aborted", "its robot is gone"


async def test_console_lists_actions_and_sends_goals(platform: RealPlatform, world: World, tmp_path: Path) -> None:
    env = user_environ(tmp_path, platform.url)
    action = f"{world.environment.tag}/fibonacci"
    listed = await rce("action", "list", world.environment.tag, env=env)
    assert "/fibonacci" in listed
    assert "test_msgs/action/Fibonacci" in listed
    assert "Action servers: 1\n    /fibonacci\n" in await rce("action", "info", action, env=env)
    numbers = "\n  sequence:\n  - 0\n  - 1\n  - 1\n"
    feedback, result = f"feedback:{numbers}", f"status: succeeded\nresult:{numbers}"

    async def send(*words: str) -> str:  # the answer, or the feedback, is lost if DDS discovery has not finished
        while "did not answer" in (report := await rce("action", "send_goal", action, *words, env=env, status=None)):
            pass
        command, _, printed = report.partition("\n")
        return f"{command.rpartition(': ')[2]}\n{printed}"

    while (answer := await send(TYPE, "{order: 3}", "--feedback")) != f"0\n{feedback}{result}\n":
        assert answer == f"0\n{result}\n"
    rejected = await send(TYPE, "{order: -1}")
    assert rejected.startswith("1\n")
    assert "rejected the goal" in rejected
    async with running("action", "send_goal", action, TYPE, "{order: 0}", "-f", env=env) as endless:
        await endless.expect_line("feedback:")
        assert await endless.interrupt() == 130


async def test_goal_of_a_server_that_ends_is_lost(world: World) -> None:
    goal = await world.client.send_goal({"order": ENDLESS}, timeout=WAIT)
    await world.environment.remove_node("server")
    with pytest.raises(Lost, match="the server is gone"):
        await goal.result(WAIT)


async def test_goal_of_a_server_that_is_killed_is_lost(platform: RealPlatform, world: World) -> None:
    await world.environment.add_node("server", "Relay", "fibonacci.py")
    await wait_for_server(world.client)
    goal = await world.client.send_goal({"order": ENDLESS}, timeout=WAIT)
    os.kill(platform.pid(r"fibonacci\.py"), signal.SIGKILL)
    with pytest.raises(Lost, match="the server is gone"):
        await goal.result(WAIT)
