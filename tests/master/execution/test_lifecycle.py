"""Lifecycle of environments and nodes: start, failure, death and restart."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from msgspec.structs import replace

from master.execution.lifecycle import RETRY_FIRST, RETRY_MOST
from rce.control.calls.call import Call, Nothing
from rce.control.calls.endpoints import AddRoute, Bind, LinkLost, NodeDied, Report, StartNode, Sync
from rce.control.calls.environments import (
    EnvironmentDied,
    KeepEnvironments,
    LimitReached,
    StartEnvironment,
    StopEnvironment,
)
from rce.control.calls.robots import DescribeType, SendStatus
from rce.errors import ErrorInfo, InvalidRequest, NotFound, StartFailed, Unauthorized, UnknownType
from rce.protocol import messages as m
from tests.support.master.desk import Desk
from tests.support.master.peers import Furnished, Platform, execute, login, told


async def test_environment_is_acknowledged_when_it_is_in_sync(platform: Platform) -> None:
    west = await platform.endpoint()
    m1 = await platform.process("container", "m1", capacity=4)
    assert (await m1.next(KeepEnvironments)).runs == []
    await login(west, "ann/r1")
    made = asyncio.ensure_future(execute(west, "ann/r1", m.CreateContainer("brain")))
    node = asyncio.ensure_future(execute(west, "ann/r1", m.AddNode("brain", "n", "p", "e")))
    spec = (await m1.next(StartEnvironment)).environment
    assert spec.name == "ann/brain"
    assert not made.done()
    brain = await platform.process("environment", spec.name, token=spec.token)
    sync = await brain.next(Sync)
    assert [each.tag for each in sync.nodes] == ["n"]
    await asyncio.gather(made, node)
    await execute(west, "ann/r1", m.DestroyContainer("brain"))
    assert (await m1.next(StopEnvironment)).name == "ann/brain"


async def test_failed_start_is_reported_and_undone(platform: Platform) -> None:
    west = await platform.endpoint()
    m1 = await platform.process("container", "m1", capacity=4)
    await login(west, "ann/r1")
    m1.refuse[StartEnvironment] = StartFailed("no image", image="x")
    with pytest.raises(StartFailed, match="no image") as raised:
        await execute(west, "ann/r1", m.CreateContainer("brain"))
    assert raised.value.info.fields == {"image": "x"}
    await m1.next(StopEnvironment)
    assert len(platform.master.state.environments) == 0


async def test_environment_that_does_not_join_is_reported_and_undone(platform: Platform) -> None:
    west = await platform.endpoint()
    m1 = await platform.process("container", "m1", capacity=4)
    await login(west, "ann/r1")
    made = execute(west, "ann/r1", m.CreateContainer("brain"))
    spec = (await m1.next(StartEnvironment)).environment
    await m1.call(EnvironmentDied(spec.name, spec.run, "exit status 1"))
    with pytest.raises(StartFailed, match="exit status 1"):
        await made
    await m1.next(StopEnvironment)
    assert len(platform.master.state.environments) == 0


async def test_dead_environment_is_restarted(furnished: Furnished) -> None:
    platform, m1, west, brain = furnished.platform, furnished.m1, furnished.west, furnished.brain
    first = platform.master.state.environments["ann/brain"].run
    await m1.call(EnvironmentDied("ann/brain", first, "killed"))
    told = (await west.next(SendStatus)).status
    while told != m.EnvironmentEvent("brain", "lost", "killed"):
        told = (await west.next(SendStatus)).status
    spec = (await m1.next(StartEnvironment)).environment
    assert spec.run != first
    with pytest.raises(Unauthorized):
        await platform.process("environment", "ann/brain", token=brain.credential)
    second = await platform.process("environment", spec.name, token=spec.token)
    assert [each.tag for each in (await second.next(Sync)).interfaces] == ["pose"]
    assert (await second.next(AddRoute)).route.link != furnished.link


def die(desk: Desk, reason: str) -> None:
    desk.hand.begin(desk.master._lifecycle._environment_died(EnvironmentDied("ann/brain", desk.run("brain"), reason)))


def test_failed_restart_is_retried_with_growing_pauses(desk: Desk) -> None:
    m1 = desk.machine("m1")
    desk.made("brain")
    m1.refuse[StartEnvironment] = StartFailed("engine is down")
    die(desk, "killed")
    pauses: list[float] = []
    before = desk.hand.time()
    while len(pauses) < 8:
        starts = len(m1.got(StartEnvironment))
        while len(m1.got(StartEnvironment)) == starts:
            desk.turn(RETRY_FIRST)
        pauses.append(desk.hand.time() - before)
        before = desk.hand.time()
    assert pauses == [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, RETRY_MOST, RETRY_MOST]
    runs = [call.environment.run for call in m1.got(StartEnvironment)]
    assert len(set(runs)) == len(runs)
    m1.refuse.clear()
    desk.turn(RETRY_MOST)
    assert desk.endpoint("brain").got(Sync)
    die(desk, "killed again")
    desk.turn(RETRY_FIRST)  # it had worked, so the pauses begin anew
    assert len(m1.got(StartEnvironment)) == len(runs) + 2


def test_type_request_does_not_prevent_a_restart(desk: Desk) -> None:
    m1 = desk.machine("m1")
    desk.made("brain")
    die(desk, "killed")
    asked = desk.hand.begin(desk.master.robot_questions.describe_type(DescribeType("ann", "my_msgs/msg/A", "msg")))
    assert not asked.done()
    desk.turn(RETRY_FIRST)
    die(desk, "killed again")
    assert isinstance(asked.exception(), UnknownType)
    desk.turn(2 * RETRY_FIRST)
    assert len(m1.got(StartEnvironment)) == 3


async def test_environment_with_restart_no_is_not_restarted(platform: Platform) -> None:
    west = await platform.endpoint()
    m1 = await platform.process("container", "m1", capacity=4)
    await login(west, "ann/r1")
    made = execute(west, "ann/r1", m.CreateContainer("brain", m.ContainerData(restart="no")))
    await platform.environment(m1)
    await made
    run = platform.master.state.environments["ann/brain"].run
    await m1.call(EnvironmentDied("ann/brain", run, "killed"))
    assert len(platform.master.state.environments) == 0


async def test_node_that_ran_is_restarted(furnished: Furnished) -> None:
    await execute(furnished.west, "ann/r1", m.AddNode("brain", "n", "p", "e"))
    first = await furnished.brain.next(StartNode)
    await furnished.brain.call(NodeDied("n", -9, ["last words"], seconds=60))
    event = await told(furnished.west, m.NodeEvent)
    assert event == m.NodeEvent("brain", "n", -9, ["last words"])
    assert await furnished.brain.next(StartNode) == first


def test_death_of_a_node_is_reported_once_until_it_is_started_again(desk: Desk) -> None:
    """An endpoint that repeats the report fills neither the robots' queues nor the events."""
    west, brain = desk.wired()
    desk.do(m.AddNode("brain", "n", "p", "e"))
    process = desk.state.processes["ann/brain"]

    def die() -> None:
        desk.hand.begin(desk.master._lifecycle._node_ends.node_died(process, NodeDied("n", 1, ["x"], seconds=60)))

    def reports() -> int:
        return sum(isinstance(call.status, m.NodeEvent) for call in west.got(SendStatus))

    die()
    die()
    assert reports() == 1
    desk.turn(1.0)
    assert len(brain.got(StartNode)) == 2
    die()
    assert reports() == 2


def test_end_of_a_node_of_an_earlier_life_does_not_remove_that_of_the_next(desk: Desk) -> None:
    west, _ = desk.wired()
    desk.do(m.AddNode("brain", "n", "p", "e"))
    late = replace(desk.state.processes["ann/brain"], incarnation="earlier")
    desk.hand.begin(desk.master._lifecycle._node_ends.node_died(late, NodeDied("n", 0, ["x"])))
    assert "ann/brain/n" in desk.state.nodes
    assert not any(isinstance(call.status, m.NodeEvent) for call in west.got(SendStatus))


def test_pauses_of_removed_environments_are_forgotten(desk: Desk) -> None:
    desk.machine("m1")
    desk.made("brain")
    killed = EnvironmentDied("ann/brain", desk.run("brain"), "killed")
    desk.hand.do(lambda: desk.master._lifecycle._died(killed))
    assert [*desk.master._lifecycle._retries] == ["ann/brain"]
    desk.do(m.DestroyContainer("brain"))
    assert desk.master._lifecycle._retries == {}


@pytest.mark.parametrize(
    "call",
    [
        NodeDied("n", 1, ["x" * 1001]),
        NodeDied("n", 1, ["x"] * 51),
        NodeDied("n" * 1001, 1, []),
        LinkLost("l", "x" * 1001),
        Report("ann/brain", "x" * 1001),
    ],
)
async def test_report_with_long_texts_is_refused(furnished: Furnished, call: Call[Nothing]) -> None:
    with pytest.raises(InvalidRequest, match="length"):
        await furnished.brain.call(call)


async def test_texts_of_an_environments_errors_are_cut(furnished: Furnished) -> None:
    error = ErrorInfo("x" * 10_000, "y" * 10_000, "z" * 10_000, "a" * 10_000, {"b": "c" * 10_000})
    await furnished.brain.call(Report("ann/brain", "pose", error))
    said = await told(furnished.west, ErrorInfo)
    assert (len(said.code), len(said.message), len(said.item), len(said.field), said.fields) == (
        200,
        8000,
        200,
        200,
        {},
    )


async def test_failed_restart_of_a_node_is_reported(furnished: Furnished) -> None:
    await execute(furnished.west, "ann/r1", m.AddNode("brain", "n", "p", "e"))
    furnished.brain.refuse[StartNode] = StartFailed("its file is gone")
    await furnished.brain.call(NodeDied("n", 1, [], seconds=60))
    assert (await told(furnished.west, ErrorInfo)).message == "its file is gone"
    assert len(furnished.platform.master.state.nodes) == 0


@pytest.mark.parametrize("died", [NodeDied("n", 0, [], seconds=60), NodeDied("n", 1, [], seconds=1)])
async def test_ended_or_broken_node_frees_its_tag(furnished: Furnished, died: NodeDied) -> None:
    await execute(furnished.west, "ann/r1", m.AddNode("brain", "n", "p", "e"))
    await furnished.brain.call(died)
    assert (await told(furnished.west, m.NodeEvent)).status == died.status
    await execute(furnished.west, "ann/r1", m.AddNode("brain", "n", "p", "other"))


async def test_failing_interface_is_reported_and_undone(furnished: Furnished) -> None:
    furnished.brain.refuse[Bind] = NotFound("no such type")
    with pytest.raises(NotFound, match="no such type"):
        await execute(furnished.west, "ann/r1", m.AddInterface("brain", "x", "PublisherInterface", "a/B"))
    assert "ann/brain/x" not in furnished.platform.master.state.interfaces


async def test_defect_in_another_process_is_an_internal_error(furnished: Furnished, failures: list[Any]) -> None:
    furnished.brain.refuse[StartNode] = ZeroDivisionError("defect")
    with pytest.raises(Exception, match="internal error while answering StartNode"):
        await execute(furnished.west, "ann/r1", m.AddNode("brain", "n", "p", "e"))
    assert [event["log_failure"].type for event in failures] == [ZeroDivisionError]
    failures.clear()


async def test_limit_reached_is_reported_to_the_user(furnished: Furnished) -> None:
    run = furnished.platform.master.state.environments["ann/brain"].run
    await furnished.m1.call(LimitReached("ann/brain", "an earlier one", "late"))
    await furnished.m1.call(LimitReached("ann/brain", run, "memory"))
    assert await told(furnished.west, m.LimitEvent) == m.LimitEvent("environment brain: memory")
