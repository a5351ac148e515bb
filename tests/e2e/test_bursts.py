"""Bursts of messages through an environment: each message comes back, or is counted and told."""

from __future__ import annotations

import asyncio
import re
from contextlib import suppress

import pytest

from rce.client import Publisher, Robot, Subscriber
from rce.errors import TimedOut
from rce.protocol.messages import DropEvent
from tests.support.e2e.original_robot import (
    OriginalRobot,
    Received,
    configure,
    connection,
    container,
    destroy,
    interface,
    message,
    status,
)
from tests.support.e2e.real_platform import RealPlatform, until
from tests.support.e2e.traffic import STRING

DEEP_NODE = f"10000 {STRING}"  # what a node's own subscription drops, nobody else can know
BURSTS = [(10_000, 100), (100, 100_000)]


class Drops:
    """Drops of all interfaces that the platform told a robot of."""

    def __init__(self, robot: Robot) -> None:
        self._counts: dict[str, int] = {}
        self._events = robot.events()

    async def until(self, total: int) -> None:
        """Wait until that many drops were told."""
        async with asyncio.timeout(60):
            while sum(self._counts.values()) < total:
                event = await self._events.get()
                if isinstance(event, DropEvent):
                    self._counts[event.iTag] = event.count
        assert sum(self._counts.values()) == total


async def wait_for_relay(there: Publisher, back: Subscriber) -> None:
    """Send until a message comes back."""
    async with asyncio.timeout(60):
        while True:
            await there.publish({"data": "ready"})
            with suppress(TimedOut):
                await back.get(1)
                return


@pytest.mark.parametrize(("count", "size"), BURSTS)
async def test_messages_of_a_burst_come_back_or_are_told(platform: RealPlatform, count: int, size: int) -> None:
    async with platform.robot(f"sender{size}") as robot, robot.environment(f"burst{size}") as environment:
        drops = Drops(robot)
        await environment.add_node("relay", "Relay", "relay.py", args=DEEP_NODE)
        back = await environment.subscriber("/out_String", STRING, depth=count)
        there = await environment.publisher("/in_String", STRING)
        await wait_for_relay(there, back)
        for number in range(count):
            await there.publish({"data": f"{number} ".ljust(size, ".")})
        received: list[int] = []
        while not received or received[-1] < count - 1:
            if (word := (await back.get(120))["data"].split()[0]) != "ready":
                received.append(int(word))
        assert received == sorted(set(received))
        assert len(received) >= min(count, 1000), "as many as wait by default"
        await drops.until(count - len(received))


async def test_robot_without_events_is_told_by_errors(platform: RealPlatform) -> None:
    count = 10_000
    async with OriginalRobot(platform.url, "plain") as robot:
        await robot.send(
            container("old"),
            configure("addNodes", containerTag="old", nodeTag="relay", pkg="Relay", exe="relay.py", args=DEEP_NODE),
            interface("old", "in", "PublisherInterface", STRING, addr="/in_String"),
            interface("old", "out", "SubscriberInterface", STRING, addr="/out_String"),
            interface("plain", "mouth", "SubscriberConverter", STRING),
            interface("plain", "ear", "PublisherConverter", STRING),
            connection("old/in", "plain/mouth"),
            connection("old/out", "plain/ear"),
        )
        await robot.take_frame(status("mouth", True), status("ear", True))
        async with asyncio.timeout(60):
            while not any(is_data(frame) for frame in robot.received):
                await robot.send(message("mouth", STRING, {"data": "ready"}))
                await asyncio.sleep(0.2)
        await robot.send(*(message("mouth", STRING, {"data": f"{number} ".ljust(100)}) for number in range(count)))
        await until(lambda: returned(robot.received)[-1:] == [count - 1], 240, "the last message")
        received = len(returned(robot.received))
        await until(lambda: received + sum(told(robot.received).values()) >= count, 60, "all drops")
        assert received + sum(told(robot.received).values()) == count
        await robot.send(destroy("old"))


def is_data(frame: Received) -> bool:
    return isinstance(frame, dict) and frame["type"] == "DM"


def returned(frames: list[Received]) -> list[int]:
    """Return the numbers of the burst that came back."""
    words = [frame["data"]["msg"]["data"].split()[0] for frame in frames if isinstance(frame, dict) and is_data(frame)]
    return [int(word) for word in words if word != "ready"]


def told(frames: list[Received]) -> dict[str, int]:
    """Return the newest number of drops of each interface."""
    errors = [frame["data"] for frame in frames if isinstance(frame, dict) and frame["type"] == "ER"]
    return {tag: int(number) for error in errors for tag, number in re.findall(r"(\S+): (\d+) ", error)}
