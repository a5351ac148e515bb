"""SIGKILL under traffic: others go on undisturbed, and what was wanted comes back without anybody's doing."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator
from datetime import datetime
from typing import TypeVar

import pytest
from original_robot import OriginalRobot, connection, interface, message, status
from real_platform import RealPlatform, until

from rce.client import Environment, Event, Reconnected, Robot, Stream
from rce.errors import NotFound
from rce.messages import EnvironmentEvent, NodeEvent, Qos

STRING = "std_msgs/String"
PERIOD = 0.02
LATEST = 1.0  # seconds that an undisturbed message may take on a busy machine
STEADY = 6.0  # a node that ran this long is started again
GRACE = 2.0
DEEP = Qos(reliability="reliable", depth=1000)

E = TypeVar("E")


class Traffic:
    """A robot that sends numbers to a node in its environment and gets them back, 50 a second."""

    def __init__(self, robot: Robot, environment: Environment, own_types: bool = True) -> None:
        """Without types of its own there are no parameters to ask for."""
        self._own_types = own_types
        self.robot = robot
        self.environment = environment
        self.sent: dict[int, float] = {}
        self.got: dict[int, float] = {}
        self.twice: list[int] = []

    async def start(self) -> None:
        environment = self.environment
        await environment.set_parameter("str", environment.tag)
        await environment.add_node("relay", "Relay", "relay.py", args=STRING)
        if self._own_types:
            await environment.add_node("parameters", "Test", "paramTest.py")
            self.parameters = await environment.service_client("/parameterTest", "Test/ParameterTest")
        self._heard = await environment.subscriber("/out_String", STRING, callback=self._hear, depth=1000, qos=DEEP)
        self._said = await environment.publisher("/in_String", STRING, qos=DEEP)
        self._task = asyncio.create_task(self._send())
        await self.flows()
        self.began = time.monotonic()

    async def stop(self) -> None:
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)

    async def steady(self) -> None:
        """The nodes have run long enough to be started again."""
        await asyncio.sleep(max(0.0, self.began + STEADY - time.monotonic()))

    async def _send(self) -> None:
        number = 0
        while True:
            if self._said.offer({"data": str(number)}, keep=1000):
                self.sent[number] = time.monotonic()
            number += 1
            await asyncio.sleep(PERIOD)

    def _hear(self, message: dict[str, str]) -> None:
        number = int(message["data"])
        if number in self.got:
            self.twice.append(number)
        self.got[number] = time.monotonic()

    async def flows(self, seconds: float = 30.0) -> None:
        """What is sent from now on comes back."""
        now = time.monotonic()
        await until(lambda: any(self.sent[number] > now for number in self.got), seconds, "traffic")
        assert not self.twice
        assert list(self.got) == sorted(self.got)

    async def check_undisturbed(self, since: float) -> None:
        """All that was sent since then has come back, in time."""
        last = next(reversed(self.sent))
        await until(lambda: last in self.got, what=f"the message {last} of {self.robot.name}")
        late = {
            number: round(self.got.get(number, 1e9) - sent, 2)
            for number, sent in self.sent.items()
            if since < sent and number <= last and self.got.get(number, 1e9) - sent > LATEST
        }
        assert not late, f"{self.robot.name}: late or lost by seconds: {late}"
        assert not self.twice

    async def parameter(self) -> str:
        answer = await self.parameters.call({}, timeout=20)
        value: str = json.loads(answer["msg"])["str"]
        return value


async def next_event(events: Stream[Event], kind: type[E], wanted: str = "") -> E:
    """The next event of that kind, whose text has that word."""
    async with asyncio.timeout(30):
        async for event in events:
            if isinstance(event, kind) and wanted in str(event):
                return event
    raise AssertionError


@pytest.fixture(scope="module")
async def killed(arguments: list[str], tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[RealPlatform]:
    """The platform whose parts are killed here, one after the other: each time it must be whole again."""
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


async def test_the_socket_of_a_robot(killed: RealPlatform, both: tuple[Traffic, Traffic]) -> None:
    """One with the client library resumes; one of the original is gone after the grace time, and may come anew."""
    victim, calm = both
    since, events = time.monotonic(), victim.robot.events()
    assert victim.robot.connection is not None
    victim.robot.connection._socket.transport.abort()
    assert await next_event(events, Reconnected) == Reconnected(resumed=True)
    await victim.flows()

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
            await broken.settled()
            assert broken.received == []
    await calm.check_undisturbed(since)


async def test_the_master(killed: RealPlatform, both: tuple[Traffic, Traffic]) -> None:
    """Data flows on. What was acknowledged is kept, what was asked for meanwhile is done."""
    robot = both[0].robot
    await robot.add_interface("v", "kept", "PublisherInterface", STRING, addr="/kept")
    await robot.add_interface("victim", "kept", "SubscriberConverter", STRING)
    since, restarts = time.monotonic(), killed.log.count("Master serves robots")
    killed.kill(killed.pid("-m master "))
    await robot.connect("v/kept", "victim/kept")
    done = time.time()
    begun = [line for line in killed.log.splitlines() if "Master serves robots" in line]
    assert len(begun) == restarts + 1
    assert done - datetime.fromisoformat(json.loads(begun[-1])["time"]).timestamp() < 2
    for traffic in both:
        await traffic.check_undisturbed(since)
    await robot.remove_interface("v", "kept")
    with pytest.raises(NotFound):
        await robot.remove_interface("v", "kept")
    async with robot.environment("after") as after:
        await after.add_node("relay", "Relay", "relay.py", args=STRING)
    await robot.remove_interface("victim", "kept")


async def test_the_robot_endpoint(killed: RealPlatform, both: tuple[Traffic, Traffic]) -> None:
    """Its robots come back by themselves; environments and nodes have not noticed."""
    events = [traffic.robot.events() for traffic in both]
    nodes = relay_pids(killed)
    killed.kill(killed.pid("-m endpoints.robot "))
    for each in events:
        await next_event(each, Reconnected)
    for traffic in both:
        await traffic.flows()
        assert await traffic.parameter() == traffic.environment.tag
    assert relay_pids(killed) == nodes


async def test_the_task_set(killed: RealPlatform, both: tuple[Traffic, Traffic]) -> None:
    """The next one adopts the environments, and then looks after them as the one before did."""
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
    await victim.flows()
    await calm.check_undisturbed(since)


async def test_a_node(killed: RealPlatform, both: tuple[Traffic, Traffic]) -> None:
    calm, victim = both  # here the other way round: its nodes have run for long
    await victim.steady()
    since, events = time.monotonic(), victim.robot.events()
    (pid,) = (pid for pid in relay_pids(killed) if "/c/" in killed.processes()[pid])
    killed.kill(pid)
    died = await next_event(events, NodeEvent)
    assert (died.containerTag, died.nodeTag, died.status) == ("c", "relay", -9)
    await victim.flows()
    await calm.check_undisturbed(since)
    assert len(relay_pids(killed)) == 2


async def test_an_environment_endpoint(killed: RealPlatform, both: tuple[Traffic, Traffic]) -> None:
    victim, calm = both
    since, events = time.monotonic(), victim.robot.events()
    old = set(killed.processes())
    pid = killed.environment_pid("v")
    nodes = {each for each in old if "/v/" in killed.processes()[each] and each != pid}
    assert len(nodes) >= 2
    killed.kill(pid)
    assert (await next_event(events, EnvironmentEvent)).state == "lost"
    assert (await next_event(events, EnvironmentEvent)).state == "ready"
    await victim.flows()
    assert await victim.parameter() == "v"
    await calm.check_undisturbed(since)
    assert not nodes & set(killed.processes())
    directories = killed.directory / "data" / "container" / "environments" / "testUser" / "v"
    assert len(list(directories.iterdir())) == 1


async def test_an_environment_that_shall_not_come_back(killed: RealPlatform, both: tuple[Traffic, Traffic]) -> None:
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


async def test_rce_up_itself(fragile: RealPlatform) -> None:
    """Whatever becomes of it, its parts and the environments end with it."""
    async with fragile.robot("r") as robot:
        await robot.create_environment("e")
        await robot.add_node("e", "relay", "Relay", "relay.py", args=STRING)
        fragile.kill(fragile.pid(r"rce up "))
        await until(lambda: not fragile.processes(), 30, "all processes end")
    await fragile.start()  # shared memory of those that had to be killed goes at the next start; see the fixture's end
