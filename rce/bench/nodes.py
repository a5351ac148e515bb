"""The nodes of the benchmark, which take round trips between themselves, and what the routes that use them share."""

from __future__ import annotations

import itertools
import json
from collections.abc import Awaitable, Callable, Sequence
from contextlib import AsyncExitStack
from functools import partial
from typing import NamedTuple

from rce.bench.floors import Sample
from rce.bench.payloads import IMAGE, ROW
from rce.client import Environment, Publisher, Robot, Subscriber
from rce.errors import TimedOut

ECHO_TIMEOUT = 30.0
PATIENCE = 0.5  # seconds until an unanswered message is sent again, while nodes start
PACKAGE = "rce_bench"


class Probe(NamedTuple):
    """`sample` takes one round trip of a message of that size and returns the seconds; `size` if it has only one."""

    name: str
    transport: str
    sample: Sample
    beside: str = ""
    size: int | None = None


class Place(NamedTuple):
    """Where a route is laid: what it needs from `stack` is taken down with it."""

    robot: Robot
    environment: Environment
    stack: AsyncExitStack
    features: Sequence[str] = ()


async def between(measure: Environment, echo: Environment, namespace: str, kinds: Sequence[str]) -> MeasuringNode:
    """A measuring node in one environment and its echo in the same or another; they are in one ROS graph."""
    node = await start(measure, echo, namespace, kinds)
    await node.found(kinds)
    return node


async def start(measure: Environment, echo: Environment, namespace: str, kinds: Sequence[str]) -> MeasuringNode:
    """The same, before the two have found each other."""
    echoes = " ".join(f"{kind}:{kind}" for kind in kinds)
    await echo.add_node(f"{namespace}_echo", PACKAGE, "echo", args=echoes, namespace=namespace)
    await measure.add_node(f"{namespace}_measure", PACKAGE, "measure", args=" ".join(kinds), namespace=namespace)
    orders = await measure.publisher(f"/{namespace}/order", "std_msgs/String")
    reports = await measure.subscriber(f"/{namespace}/report", "std_msgs/String")
    return MeasuringNode(orders, reports)


class MeasuringNode:
    """The node `measure`, as ordered by the robot: it takes the round trip and the time."""

    def __init__(self, orders: Publisher, reports: Subscriber) -> None:
        self._orders = orders
        self._reports = reports
        self._numbers = itertools.count(1)

    def probes(self, route: str, kinds: Sequence[str], beside: str = "") -> list[Probe]:
        """Those of a route, to be compared with those of the route `beside`."""
        return [
            Probe(
                f"{route} {kind}",
                "service" if kind == "service" else "topic",
                self._probe(kind),
                f"{beside} {kind}" if beside else "",
                IMAGE if kind == "image" else None,
            )
            for kind in kinds
        ]

    def _probe(self, kind: str) -> Sample:
        async def sample(size: int) -> float:
            return await self._order(kind, size, ECHO_TIMEOUT)

        return sample

    async def found(self, kinds: Sequence[str]) -> None:
        """Wait until the two nodes have found each other, on every topic and service."""
        for kind in kinds:
            await eventually(partial(self._order, kind, ROW))
        await drain(self._reports)

    async def _order(self, kind: str, size: int, timeout: float) -> float:  # noqa: ASYNC109  # as Subscriber.get
        number = next(self._numbers)
        await self._orders.publish({"data": json.dumps({"number": number, "kind": kind, "size": size})})
        while True:
            report = json.loads((await self._reports.get(timeout))["data"])
            if report["number"] == number:
                return float(report["seconds"])


async def eventually(attempt: Callable[[float], Awaitable[object]]) -> None:
    """Repeat until it is answered: nodes need time to start and to find each other. TimedOut."""
    for _ in range(round(ECHO_TIMEOUT / PATIENCE)):
        try:
            await attempt(PATIENCE)
            return
        except TimedOut:
            continue
    raise TimedOut(f"the nodes of the benchmark have not answered within {ECHO_TIMEOUT:g} s")


async def drain(subscriber: Subscriber) -> None:
    """Take late answers to what had been given up, so that they are not taken for later ones."""
    try:
        while True:
            await subscriber.get(PATIENCE)
    except TimedOut:
        return
