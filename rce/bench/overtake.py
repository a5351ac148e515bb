"""Small messages of a robot that sends large ones at the same time: velocity commands beside 10 MB images.

The images go to one node and the commands to another, so that only the way there is shared. The node's answer holds the
time of arrival by the monotonic clock, which robot and node have in common: run it where the platform runs.
"""

from __future__ import annotations

import asyncio
import random
import statistics
import time
from typing import Any, NamedTuple

from msgspec import Struct, to_builtins

from rce.bench.nodes import PACKAGE, Place, drain, eventually
from rce.bench.payloads import LARGEST, ROW, image_cdr
from rce.bench.report import aligned, machine
from rce.bench.run import PAUSE
from rce.bench.statistics import percentile
from rce.client import Publisher, Subscriber

TIMEOUT = 30.0
SIZE = LARGEST // ROW * ROW
MILLI = 1e3
# Of about 100 bytes in its frame.
COMMAND = {"linear": {"x": 0.5, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.25}}


class Command(NamedTuple):
    """Seconds until it arrived, and until its answer was back."""

    there: float
    back: float


class Result(Struct):
    """Commands without images and beside them; `rate` is that of the images a second."""

    alone: list[Command]
    beside: list[Command]
    rate: float


async def measure(place: Place, samples: int) -> Result:
    """Send velocity commands, first alone and then while images leave without a pause."""
    environment = place.environment
    await environment.add_node("commands", PACKAGE, "commands")
    await environment.add_node("images", PACKAGE, "images")
    wheel = Wheel(
        await environment.publisher("/command", "geometry_msgs/Twist"),
        await environment.subscriber("/arrival", "std_msgs/Float64"),
    )
    images = await environment.publisher("/image", "sensor_msgs/Image", raw=True)
    await wheel.found()
    alone = await wheel.turn(samples)
    flood = Flood(images)
    sending = asyncio.create_task(flood.send())
    try:
        await flood.flowing.wait()
        began, before = time.monotonic(), flood.sent
        beside = await wheel.turn(samples)
        rate = (flood.sent - before) / (time.monotonic() - began)
    finally:
        sending.cancel()
        await asyncio.gather(sending, return_exceptions=True)
    if place.robot.connection is not None:
        await place.robot.connection.flush()  # the platform would complain of images for a topic that is gone
    return Result(alone, beside, rate)


class Flood:
    """Images as fast as the platform takes them; `flowing` once all queues have some."""

    def __init__(self, publisher: Publisher) -> None:
        self.sent = 0
        self.flowing = asyncio.Event()
        self._publisher = publisher

    async def send(self) -> None:
        image = image_cdr(SIZE)
        while True:
            await self._publisher.publish(image)
            await asyncio.sleep(0)  # while there is room `publish` does not wait
            self.sent += 1
            if self.sent >= 20:
                self.flowing.set()


class Wheel:
    """Velocity commands and the answers to them."""

    def __init__(self, commands: Publisher, arrivals: Subscriber) -> None:
        self._commands = commands
        self._arrivals = arrivals

    async def found(self) -> None:
        """Wait until the node answers."""
        await eventually(self._command)
        await drain(self._arrivals)

    async def turn(self, samples: int) -> list[Command]:
        taken = []
        for _ in range(samples):
            taken.append(await self._command(TIMEOUT))
            await asyncio.sleep(random.uniform(*PAUSE))
        return taken

    async def _command(self, timeout: float) -> Command:  # noqa: ASYNC109  # as Subscriber.get
        began = time.monotonic()
        await self._commands.publish(COMMAND)
        arrived = (await self._arrivals.get(timeout))["data"]
        return Command(arrived - began, time.monotonic() - began)


def as_data(result: Result) -> dict[str, Any]:
    data: dict[str, Any] = to_builtins({"machine": machine(), "overtake": result})
    return data


def as_text(result: Result) -> str:
    """Milliseconds."""
    rows = [["velocity commands, ms", "p50", "p99", "most", "and back: p50", "p99", "most"]]
    for name, taken in (("alone", result.alone), (f"beside {SIZE / 1e6:.0f} MB images", result.beside)):
        figures = [*_figures([each.there for each in taken]), *_figures([each.back for each in taken])]
        rows.append([name, *(f"{each * MILLI:.2f}" for each in figures)])
    return "\n".join([*aligned(rows), f"{result.rate:.1f} images a second"])


def _figures(taken: list[float]) -> tuple[float, float, float]:
    return statistics.median(taken), percentile(taken, 99), max(taken)
