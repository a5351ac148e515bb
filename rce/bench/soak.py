"""Soak: robots come and go for a long time, and no process of the platform may grow.

Every visitor has a name of its own, so that nothing that is kept by name is used again. A visitor connects, adds
interfaces to itself and to an environment that lasts, sends messages that a node sends back, and leaves. Some bring an
environment with a node and parameters; some vanish without a goodbye.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import re
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from msgspec import Struct, field, to_builtins

from rce.api.http import EntryClient, basic
from rce.bench.nodes import PACKAGE, retry
from rce.bench.report import aligned, machine
from rce.bench.resources import FLAT, Observer, Series, trend
from rce.client import Robot
from rce.client.address import Address
from rce.errors import RceError
from rce.protocol.messages import InterfaceType

LASTING = "lasting"
TYPE = "std_msgs/String"
MESSAGES = 20  # of each visitor
INTERVAL = 10.0  # seconds between samples
REPORTED = 30  # samples between interim results
MAX_VISITORS = 8  # at the same time
EVERY_ENVIRONMENT, EVERY_VANISHING = 6, 5  # one visitor in so many
TIMEOUT = 30.0  # seconds
MEGABYTE = 1e6
_NUMBER = re.compile(r"\d+")


class Result(Struct):
    """Result of a soak.

    Attributes:
        seconds: Duration.
        visits: Number of visitors that came and went; of these, some with an environment and some that vanished.
        environments: Number of visitors with an environment.
        failures: Number of visits that failed, by reason.
        restarts: Processes that ended.
        series: Samples by process.
    """

    seconds: float = 0.0
    visits: int = 0
    environments: int = 0
    failures: dict[str, int] = field(default_factory=dict)
    restarts: list[str] = field(default_factory=list)
    series: dict[str, Series] = field(default_factory=dict)


class Soak:
    """Visitors of one platform."""

    def __init__(self, url: str, user: str, password: str, report: Callable[[Result], None]) -> None:
        """All visitors are robots of one user; `report` gets interim results."""
        self.result = Result()
        self._report = report
        self._url, self._user, self._password = url, user, password
        self._failures: Counter[str] = Counter()

    def robot(self, name: str) -> Robot:
        """Return a robot that is not connected yet."""
        return Robot(self._url, user=self._user, robot=name, password=self._password, timeout=TIMEOUT)

    async def run(self, observer: Observer, seconds: float, rate: float) -> Result:
        """Let visitors come at `rate` a second; each MAX_VISITORS that are there delay the next one."""
        async with self.robot("host") as host, host.environment(LASTING) as lasting:
            await lasting.add_node("echo", PACKAGE, "echo", args="in:string", namespace=LASTING)
            await self._talk(host, LASTING)
            began = time.monotonic()
            async with asyncio.TaskGroup() as group:  # an error of the sampler ends the run
                sampling = group.create_task(self._sample(observer, began))
                await self._receive(began, seconds, rate)
                sampling.cancel()
        return self._summary(observer, began)

    def _summary(self, observer: Observer, began: float) -> Result:
        self.result.seconds = time.monotonic() - began
        self.result.failures = dict(self._failures.most_common())
        self.result.restarts, self.result.series = observer.restarts, observer.series
        return self.result

    async def _sample(self, observer: Observer, began: float) -> None:
        for number in itertools.count(1):
            await asyncio.sleep(INTERVAL)
            await asyncio.to_thread(observer.sample, time.monotonic() - began)
            if number % REPORTED == 0:
                self._report(self._summary(observer, began))

    async def _receive(self, began: float, seconds: float, rate: float) -> None:
        gate = asyncio.Semaphore(MAX_VISITORS)
        async with asyncio.TaskGroup() as group:
            for number in itertools.count(1):
                due = began + number / rate
                if due > began + seconds:
                    return
                await asyncio.sleep(due - time.monotonic())
                await gate.acquire()
                group.create_task(self._visit(number)).add_done_callback(lambda _: gate.release())

    async def _visit(self, number: int) -> None:
        try:
            if number % EVERY_VANISHING == 0:
                await self._vanish(f"gone_{number}")
            elif number % EVERY_ENVIRONMENT == 0:
                await self._bring_environment(f"owner_{number}")
                self.result.environments += 1
            else:
                async with self.robot(f"guest_{number}") as robot:
                    await self._talk(robot, LASTING)
            self.result.visits += 1
        except (RceError, OSError) as error:
            self._failures[f"{type(error).__name__}: {_NUMBER.sub('N', str(error))}"] += 1

    async def _vanish(self, name: str) -> None:
        """Break the connection, so that the session lasts until its grace period is over."""
        address = Address(self._url, self._user, name, self._password)
        websocket = await address.dial(await address.locate(), "")
        await websocket.receive()
        added = {"endpointTag": name, "interfaceTag": "in", "interfaceType": "PublisherConverter", "className": TYPE}
        await websocket.send(json.dumps({"type": "CN", "data": {"addInterfaces": [added]}, "id": 1}).encode(), True)
        await asyncio.wait_for(websocket.receive(), TIMEOUT)
        websocket.abort()

    async def _bring_environment(self, name: str) -> None:
        async with self.robot(name) as robot, robot.environment(f"of_{name}", restart="no") as environment:
            await environment.set_parameter("owner", name)
            await environment.add_node("echo", PACKAGE, "echo", args="in:string", namespace=LASTING)
            await self._talk(robot, environment.tag)

    async def _talk(self, robot: Robot, environment: str) -> None:
        """Send messages to the node of an environment by interfaces of the visitor's own, and receive them."""
        mark = robot.name
        ends: dict[str, tuple[InterfaceType, str]] = {
            f"{mark}_pub": ("PublisherInterface", "in"),
            f"{mark}_sub": ("SubscriberInterface", "in_back"),
        }
        for tag, (kind, topic) in ends.items():
            await robot.add_interface(environment, tag, kind, TYPE, addr=f"/{LASTING}/{topic}")
        out = await robot.publisher("out", TYPE, to=f"{environment}/{mark}_pub")
        back = await robot.subscriber("back", TYPE, to=f"{environment}/{mark}_sub")

        async def echo(text: str, timeout: float) -> None:  # noqa: ASYNC109  # as Subscriber.get
            await out.publish({"data": text})
            while (await back.get(timeout))["data"] != text:  # those of others arrive too
                pass

        await retry(lambda timeout: echo(f"{mark} begins", timeout))
        for number in range(MESSAGES):
            await echo(f"{mark} {number}", TIMEOUT)
        await out.close()  # the others end with the session
        for tag in ends:
            await robot.remove_interface(environment, tag)


async def measure(
    url: str, user: str, directory: Path, minutes: float, rate: float, report: Callable[[Result], None]
) -> Result:
    """Run a soak on a platform that this process has started with `--dev`.

    Args:
        url: Entry of the platform.
        user: User of the visitors, whose password is the name.
        directory: Data of the platform.
        minutes: Duration.
        rate: Visitors a minute.
        report: Called with the result so far, every 5 min.
    """
    metrics = EntryClient(url, basic("admin", "admin"))
    observer = Observer(directory, metrics, f"{user}/{LASTING}")
    return await Soak(url, user, user, report).run(observer, minutes * 60, rate / 60)


def as_text(result: Result) -> str:
    """Return tables of the visits and of the trends after the warm-up."""
    host = machine()
    lines = [
        f"{result.visits} visits in {result.seconds / 60:.0f} min ({result.environments} with an environment), "
        f"{sum(result.failures.values())} failed; {host['processor']}, {host['cores']} cores, load {host['load']:.1f}",
        *(f"  {count} x {reason}" for reason, count in result.failures.items()),
        *(f"  {name} ended and was started again" for name in result.restarts),
        "",
    ]
    rows = [["", "figure", "after warm-up", "at the end", "growth", "an hour", ""]]
    for name, series in result.series.items():
        rows += [_row(name, kind, series) for kind in series.figures]
    return "\n".join([*lines, *aligned(rows)])


def _row(name: str, kind: str, series: Series) -> list[str]:
    found = trend(series, kind)
    scale, unit = (MEGABYTE, " MB") if kind in ("memory", "database") else (1, "")
    return [
        name,
        kind,
        *(f"{value / scale:.1f}{unit}" for value in (found.first, found.last)),
        f"{100 * found.growth:+.1f} %",
        f"{found.hourly / scale:+.1f}{unit}",
        "flat" if found.flat else f"grows more than {100 * FLAT:.0f} %",
    ]


def as_data(result: Result) -> dict[str, Any]:
    """Return all samples for JSON."""
    data: dict[str, Any] = to_builtins({"machine": machine(), "soak": result})
    return data
