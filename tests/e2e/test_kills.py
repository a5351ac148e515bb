"""Processes are killed under traffic: others are not disturbed, and the platform recovers by itself."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator

import pytest

from rce.client import Reconnected
from rce.errors import NotFound
from rce.protocol.messages import EnvironmentEvent, NodeEvent
from tests.support.e2e.original_robot import OriginalRobot, connection, interface, message, status
from tests.support.e2e.real_platform import RealPlatform, until
from tests.support.e2e.traffic import STRING, Traffic, next_event

GRACE = 8.0  # seconds; enough for a robot to return on a busy machine


@pytest.fixture(scope="module")
async def killed(arguments: list[str], tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[RealPlatform]:
    """A platform whose processes these tests kill one after the other. It must recover each time."""
    async with RealPlatform(tmp_path_factory.mktemp("killed"), *arguments, "--grace", str(GRACE)) as platform:
        yield platform


@pytest.fixture(scope="module")
async def both(killed: RealPlatform) -> AsyncIterator[tuple[Traffic, Traffic]]:
    """Traffic of two robots, each with an environment."""
    async with (
        killed.robot("victim") as victim,
        killed.robot("calm") as calm,
        victim.environment("v") as v,
        calm.environment("c") as c,
    ):
        both = Traffic(victim, v), Traffic(calm, c)
        await asyncio.gather(*(each.start() for each in both))
        yield both
        await asyncio.gather(*(each.stop() for each in both))


def relay_pids(platform: RealPlatform) -> set[int]:
    return {pid for pid, words in platform.processes().items() if "relay.py" in words}


async def test_connection_of_a_robot_breaks(killed: RealPlatform, both: tuple[Traffic, Traffic]) -> None:
    """A robot with the client library resumes. One of the original is removed after the grace period."""
    victim, calm = both
    since, events = time.monotonic(), victim.robot.events()
    assert victim.robot.connection is not None
    victim.robot.connection._websocket.abort()
    assert await next_event(events, Reconnected) == Reconnected(resumed=True)
    await victim.wait_for_round_trip()

    async with OriginalRobot(killed.url, "listener") as listener:
        await listener.send(interface("listener", "ear", "PublisherConverter", STRING))
        async with OriginalRobot(killed.url, "broken") as broken:
            await broken.send(
                interface("broken", "mouth", "SubscriberConverter", STRING),
                connection("broken/mouth", "listener/ear"),
            )
            await broken.take_frame(status("mouth", True))
            await listener.take_frame(status("ear", True))
            await broken.send(message("mouth", STRING, {"data": "last words"}))
            assert (await listener.take_data("ear"))["msg"] == {"data": "last words"}
            broken.abort()
        await listener.take_frame(status("ear", False))
        async with OriginalRobot(killed.url, "broken") as broken:
            await broken.send(interface("broken", "mouth", "SubscriberConverter", STRING))
            await broken.commands_processed()
            assert broken.received == []
    await calm.check_undisturbed(since)


async def test_master_is_killed(killed: RealPlatform, both: tuple[Traffic, Traffic]) -> None:
    """Data keeps flowing. Acknowledged commands are kept, and commands sent meanwhile are executed."""
    robot = both[0].robot
    await robot.add_interface("v", "kept", "PublisherInterface", STRING, addr="/kept")
    await robot.add_interface("victim", "kept", "SubscriberConverter", STRING)
    since, restarts = time.monotonic(), killed.log.count("Master serves robots")
    killed.kill(killed.pid("-m master "))
    await robot.connect("v/kept", "victim/kept")
    assert killed.log.count("Master serves robots") == restarts + 1
    for traffic in both:
        await traffic.check_undisturbed(since)
    await robot.remove_interface("v", "kept")
    with pytest.raises(NotFound):
        await robot.remove_interface("v", "kept")
    async with robot.environment("after") as after:
        await after.add_node("relay", "Relay", "relay.py", args=STRING)
    await robot.remove_interface("victim", "kept")


async def test_robot_endpoint_is_killed(killed: RealPlatform, both: tuple[Traffic, Traffic]) -> None:
    """Its robots reconnect by themselves; environments and nodes are not affected."""
    events = [traffic.robot.events() for traffic in both]
    nodes = relay_pids(killed)
    killed.kill(killed.pid("-m endpoints.robot "))
    for each in events:
        await next_event(each, Reconnected)
    for traffic in both:
        await traffic.wait_for_round_trip()
        assert await traffic.parameter() == traffic.environment.tag
    assert relay_pids(killed) == nodes


async def test_task_set_is_killed(killed: RealPlatform, both: tuple[Traffic, Traffic]) -> None:
    """The next one adopts the environments and supervises them."""
    victim, calm = both
    since, joined = time.monotonic(), killed.log.count("container machine-1 joined")
    environments = {tag: killed.environment_pid(tag) for tag in "vc"}
    killed.kill(killed.pid("-m containers "))
    await until(lambda: killed.log.count("container machine-1 joined") > joined, what="a new task set")
    async with victim.robot.environment("new"):
        assert killed.environment_pid("new")
    assert not killed.environment_pid("new")
    for traffic in both:
        await traffic.check_undisturbed(since)
    assert {tag: killed.environment_pid(tag) for tag in "vc"} == environments

    events = victim.robot.events()
    killed.kill(environments["v"])
    assert (await next_event(events, EnvironmentEvent)).state == "lost"
    await victim.wait_for_round_trip()
    await calm.check_undisturbed(since)


async def test_node_is_killed(killed: RealPlatform, both: tuple[Traffic, Traffic]) -> None:
    calm, victim = both  # in this order, because the nodes of this one have run for long
    await victim.wait_until_restartable()
    since, events = time.monotonic(), victim.robot.events()
    killed.kill(killed.pid(r"(?=.*/testUser/c/).*relay\.py"))
    died = await next_event(events, NodeEvent)
    assert (died.containerTag, died.nodeTag, died.status) == ("c", "relay", -9)
    await victim.wait_for_round_trip()
    await calm.check_undisturbed(since)
    assert len(relay_pids(killed)) == 2


async def test_environment_endpoint_is_killed(killed: RealPlatform, both: tuple[Traffic, Traffic]) -> None:
    victim, calm = both
    since, events = time.monotonic(), victim.robot.events()
    pid = killed.environment_pid("v")
    nodes = {each for each, words in killed.processes().items() if "/v/" in words and each != pid}
    assert len(nodes) >= 2
    killed.kill(pid)
    assert (await next_event(events, EnvironmentEvent)).state == "lost"
    assert (await next_event(events, EnvironmentEvent)).state == "ready"
    await victim.wait_for_round_trip()
    assert await victim.parameter() == "v"
    await calm.check_undisturbed(since)
    await until(lambda: not nodes & set(killed.processes()), what="the earlier nodes end")
    directories = killed.directory / "data" / "container" / "environments" / "testUser" / "v"
    await until(lambda: len(list(directories.iterdir())) == 1, what="the earlier directory is removed")


async def test_environment_without_restart_is_removed(killed: RealPlatform, both: tuple[Traffic, Traffic]) -> None:
    robot, since = both[0].robot, time.monotonic()
    events = robot.events()
    await robot.create_environment("fleeting", restart="no")
    await robot.add_node("fleeting", "relay", "Relay", "relay.py", args=STRING)
    killed.kill(killed.environment_pid("fleeting"))
    gone = await next_event(events, EnvironmentEvent, "gone")
    assert gone.containerTag == "fleeting"
    assert "signal 9" in gone.reason
    with pytest.raises(NotFound):
        await robot.add_node("fleeting", "again", "Relay", "relay.py")
    await until(lambda: not [words for words in killed.processes().values() if "/fleeting/" in words])
    for traffic in both:
        await traffic.check_undisturbed(since)


async def test_rce_up_is_killed(fragile: RealPlatform) -> None:
    """All processes of the platform and the environments end with it."""
    async with fragile.robot("r") as robot:
        await robot.create_environment("e")
        await robot.add_node("e", "relay", "Relay", "relay.py", args=STRING)
        fragile.kill(fragile.pid(r"rce up "))
        await until(lambda: not fragile.processes(), what="all processes end")
    await fragile.start()  # removes shared memory of killed processes, which the fixture checks at its end
