"""Node that publishes as fast as it can, to one robot."""

from __future__ import annotations

import asyncio
import re
import time

from msgspec import Struct

from rce.bench.nodes import PACKAGE
from rce.bench.traffic.crowd import BEGIN, TICK, TYPE
from rce.bench.traffic.login import Login
from rce.bench.traffic.socket import connect
from rce.client import Robot

PATIENCE = 120.0  # seconds until the first message
WARM_UP = 2.0  # seconds that are not counted
DROPS = re.compile(rb'"topic": ?"drops".*"count": ?(\d+),(.*)')  # of all so far, and the place
NUMBER = 10  # digits of the number at the begin of a message


class Flood(Struct):
    """A node that publishes as fast as it can, to one robot.

    Attributes:
        size: Bytes of a message.
        published: Messages that the node published in a second.
        received: Messages that the robot got in a second.
        dropped: Messages in a second of whose loss the robot was told.
    """

    size: int
    published: float
    received: float
    dropped: float


class Reading:
    """Messages that the robot has received: numbers of messages, and how many were dropped, in all, by place."""

    def __init__(self) -> None:
        self.numbers: list[int] = []
        self._drops: dict[bytes, int] = {}

    def received(self, text: bytes) -> None:
        """Take a frame."""
        begin = BEGIN.search(text)
        if begin is not None:
            self.numbers.append(int(text[begin.end() : begin.end() + NUMBER]))
        elif found := DROPS.search(text):
            self._drops[found[2]] = int(found[1])

    def dropped(self) -> int:
        """Return the number of messages of whose loss the robot was told so far."""
        return sum(self._drops.values())


async def flood(login: Login, size: int, seconds: float) -> Flood:
    """Let a node publish strings of `size` bytes as fast as it can, to one robot that reads all."""
    read = Reading()
    async with (
        Robot(login.url, user=login.user, robot="keeper", key=login.key) as keeper,
        keeper.environment("flooded") as environment,
    ):
        await keeper.add_interface("flooded", "flood", "SubscriberInterface", TYPE, addr="/flood")
        url = await login.locate()
        socket = await connect(url, login.query("flooded_robot", "events"), read.received)
        try:
            await keeper.add_interface("flooded_robot", "flood", "PublisherConverter", TYPE)
            await keeper.connect("flooded_robot/flood", "flooded/flood")
            await environment.add_node("flood", PACKAGE, "flood.py", args=f"/flood {size}")
            async with asyncio.timeout(PATIENCE):
                while not read.numbers:  # noqa: ASYNC110
                    await asyncio.sleep(TICK)
            await asyncio.sleep(WARM_UP)
            read.numbers.clear()
            before = read.dropped()
            began = time.perf_counter()
            await asyncio.sleep(seconds)
            elapsed = time.perf_counter() - began
        finally:
            socket.close()
    published = read.numbers[-1] - read.numbers[0] + 1 if read.numbers else 0
    return Flood(size, published / elapsed, len(read.numbers) / elapsed, (read.dropped() - before) / elapsed)
