"""Benchmark of velocity commands of a robot that sends 10 MB images at the same time.

The images go to one node and the commands to another, so that they share only the connection of the robot. The answer
of the node contains the time of arrival by the monotonic clock: robot and node must be on one machine.
"""

from __future__ import annotations

import asyncio
import random
import statistics
import time
from typing import Any, NamedTuple

from msgspec import Struct, to_builtins

from rce.bench.nodes import PACKAGE, Place, drain, retry
from rce.bench.payloads import LARGEST, ROW, image_cdr
from rce.bench.report import aligned, machine
from rce.bench.run import PAUSE
from rce.bench.statistics import percentile
from rce.client import Publisher, Subscriber

TIMEOUT = 30.0  # seconds
SIZE = LARGEST // ROW * ROW
MILLI = 1e3
# About 100 bytes in a frame.
COMMAND = {"linear": {"x": 0.5, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.25}}


class Command(NamedTuple):
    """Times of one command in seconds: until it arrived, and until the answer arrived."""

    there: float
    back: float


class Result(Struct):
    """Results.

    Attributes:
        alone: Commands without images.
        beside: Commands while images are sent.
        rate: Images a second.
    """

    alone: list[Command]
    beside: list[Command]
    rate: float


async def measure(place: Place, samples: int) -> Result:
    """Measure velocity commands, first alone and then while images are sent without a pause."""
    environment = place.environment
    await environment.add_node("commands", PACKAGE, "commands")
    await environment.add_node("images", PACKAGE, "images")
    commands = CommandStream(
        await environment.publisher("/command", "geometry_msgs/Twist"),
        await environment.subscriber("/arrival", "std_msgs/Float64"),
    )
    images = await environment.publisher("/image", "sensor_msgs/Image", raw=True)
    await commands.wait_for_node()
    alone = await commands.measure(samples)
    flood = Flood(images)
    sending = asyncio.create_task(flood.send())
    try:
        await flood.flowing.wait()
        started, before = time.monotonic(), flood.sent
        beside = await commands.measure(samples)
        rate = (flood.sent - before) / (time.monotonic() - started)
    finally:
        sending.cancel()
        await asyncio.gather(sending, return_exceptions=True)
    if place.robot.connection is not None:
        await place.robot.connection.flush()  # otherwise images would arrive for a topic that was removed
    return Result(alone, beside, rate)


class Flood:
    """Stream of images as fast as the platform accepts them.

    Attributes:
        sent: Number of images sent.
        flowing: Set once all queues are filled.
    """

    def __init__(self, publisher: Publisher) -> None:
        """Publish on this topic."""
        self.sent = 0
        self.flowing = asyncio.Event()
        self._publisher = publisher

    async def send(self) -> None:
        """Send images until cancelled."""
        image = image_cdr(SIZE)
        while True:
            await self._publisher.publish(image)
            await asyncio.sleep(0)  # `publish` does not yield to the event loop while its queue has room
            self.sent += 1
            if self.sent >= 20:
                self.flowing.set()


class CommandStream:
    """Velocity commands and the answers to them."""

    def __init__(self, commands: Publisher, arrivals: Subscriber) -> None:
        """Use these topics of the node `commands`."""
        self._commands = commands
        self._arrivals = arrivals

    async def wait_for_node(self) -> None:
        """Wait until the node answers."""
        await retry(self._command)
        await drain(self._arrivals)

    async def measure(self, samples: int) -> list[Command]:
        """Send commands and return their times."""
        taken = []
        for _ in range(samples):
            taken.append(await self._command(TIMEOUT))
            await asyncio.sleep(random.uniform(*PAUSE))
        return taken

    async def _command(self, timeout: float) -> Command:  # noqa: ASYNC109  # as Subscriber.get
        started = time.monotonic()
        await self._commands.publish(COMMAND)
        arrived = (await self._arrivals.get(timeout))["data"]
        return Command(arrived - started, time.monotonic() - started)


def as_data(result: Result) -> dict[str, Any]:
    """Return all samples for JSON."""
    data: dict[str, Any] = to_builtins({"machine": machine(), "overtake": result})
    return data


def as_text(result: Result) -> str:
    """Return a table in milliseconds."""
    rows = [["velocity commands, ms", "p50", "p99", "most", "and back: p50", "p99", "most"]]
    for name, taken in (("alone", result.alone), (f"beside {SIZE / 1e6:.0f} MB images", result.beside)):
        figures = [*_figures([each.there for each in taken]), *_figures([each.back for each in taken])]
        rows.append([name, *(f"{each * MILLI:.2f}" for each in figures)])
    return "\n".join([*aligned(rows), f"{result.rate:.1f} images a second"])


def _figures(taken: list[float]) -> tuple[float, float, float]:
    """Return median, 99th percentile and maximum."""
    return statistics.median(taken), percentile(taken, 99), max(taken)
