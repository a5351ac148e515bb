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
DROPS = re.compile(rb'"topic": ?"drops".*"count": ?(\d+)')
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


async def flood(login: Login, size: int, seconds: float) -> Flood:
    """Let a node publish strings of `size` bytes as fast as it can, to one robot that reads all."""
    numbers: list[int] = []
    drops: list[int] = []

    def received(text: bytes) -> None:
        begin = BEGIN.search(text)
        if begin is not None:
            numbers.append(int(text[begin.end() : begin.end() + NUMBER]))
        elif found := DROPS.search(text):
            drops.append(int(found[1]))

    async with (
        Robot(login.url, user=login.user, robot="keeper", key=login.key) as keeper,
        keeper.environment("flooded") as environment,
    ):
        await keeper.add_interface("flooded", "flood", "SubscriberInterface", TYPE, addr="/flood")
        url = await login.locate()
        socket = await connect(url, login.query("flooded_robot", "events"), received)
        try:
            await keeper.add_interface("flooded_robot", "flood", "PublisherConverter", TYPE)
            await keeper.connect("flooded_robot/flood", "flooded/flood")
            await environment.add_node("flood", PACKAGE, "flood.py", args=f"/flood {size}")
            async with asyncio.timeout(PATIENCE):
                while not numbers:  # noqa: ASYNC110
                    await asyncio.sleep(TICK)
            await asyncio.sleep(WARM_UP)
            numbers.clear()
            drops.clear()
            began = time.perf_counter()
            await asyncio.sleep(seconds)
            elapsed = time.perf_counter() - began
        finally:
            socket.close()
    published = numbers[-1] - numbers[0] + 1
    return Flood(size, published / elapsed, len(numbers) / elapsed, sum(drops) / elapsed)
