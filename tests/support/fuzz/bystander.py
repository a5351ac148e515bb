"""`python -m tests.support.fuzz.bystander URL`: two robots that send messages to each other while others attack.

For each line on standard input it prints a line of JSON: the figures since the line before.
"""

from __future__ import annotations

import asyncio
import sys
import time

import msgspec
from msgspec import Struct

from rce.bench.statistics import percentile
from rce.client import Robot

USER, PASSWORD, TYPE = "bystander", "four words are enough", "std_msgs/String"
PERIOD = 0.02  # seconds between messages


class Figures(Struct):
    """Messages since the last figures; times in seconds.

    Attributes:
        sent: Number of messages sent.
        received: Number of messages that arrived.
        wrong: Number that arrived out of order, or with another content.
        p50: Median of their times.
        p99: 99th percentile of their times.
    """

    sent: int = 0
    received: int = 0
    wrong: int = 0
    p50: float = 0.0
    p99: float = 0.0


class Bystander:
    """Sends numbers from one robot to the other."""

    def __init__(self) -> None:
        self._sent_at: dict[int, float] = {}
        self._taken: list[float] = []
        self._figures = Figures()
        self._last = -1
        self._arrived = asyncio.Event()

    def _receive(self, message: dict[str, str]) -> None:
        number = int(message["data"])
        self._figures.received += 1
        self._figures.wrong += number != self._last + 1
        self._last = number
        self._taken.append(time.perf_counter() - self._sent_at.pop(number))
        self._arrived.set()

    async def _send(self, left: Robot, right: Robot) -> None:
        out = await left.publisher("out", TYPE)
        await right.subscriber("in", TYPE, to="left/out", callback=self._receive)
        await out.wait_connected()
        number = 0
        while True:
            self._sent_at[number] = time.perf_counter()
            await out.publish({"data": str(number)})
            self._figures.sent += 1
            number += 1
            await asyncio.sleep(PERIOD)

    async def run(self, url: str) -> None:
        """Send until standard input ends."""
        left, right = (Robot(url, user=USER, robot=name, password=PASSWORD) for name in ("left", "right"))
        async with left, right, asyncio.TaskGroup() as group:
            sending = group.create_task(self._send(left, right))
            while await asyncio.to_thread(sys.stdin.readline):
                await self._arrived.wait()
                self._report()
            sending.cancel()

    def _report(self) -> None:
        figures, taken, self._figures, self._taken = self._figures, self._taken, Figures(), []
        self._arrived.clear()
        figures.p50, figures.p99 = percentile(taken, 50), percentile(taken, 99)
        print(msgspec.json.encode(figures).decode(), flush=True)


if __name__ == "__main__":
    asyncio.run(Bystander().run(sys.argv[1]))
