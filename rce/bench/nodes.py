"""Nodes of the benchmark, which measure round trips between themselves, and helpers of the routes."""

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
from rce.client.address import Address
from rce.errors import TimedOut

ECHO_TIMEOUT = 30.0  # seconds
RETRY_INTERVAL = 0.5  # seconds after which an unanswered message is sent again while nodes start
PACKAGE = "rce_bench"


class Probe(NamedTuple):
    """One kind of round trip to measure.

    Attributes:
        name: Route and kind of message.
        transport: `topic`, `service` or `floor` (a bare echo).
        sample: Measures one round trip of a message of a size in bytes; returns the seconds.
        beside: Name of the probe that it is compared with, or empty.
        size: The only size of its messages, if it has only one.
    """

    name: str
    transport: str
    sample: Sample
    beside: str = ""
    size: int | None = None


class Place(NamedTuple):
    """Robot and environment that routes use.

    Attributes:
        robot: Connected robot.
        environment: Environment of the nodes.
        stack: Context of everything that routes create.
        features: Special features of machines, for routes between machines.
        address: Address and credentials of the platform, for routes of gateways.
    """

    robot: Robot
    environment: Environment
    stack: AsyncExitStack
    features: Sequence[str] = ()
    address: Address | None = None


async def start_connected(
    measure: Environment, echo: Environment, namespace: str, kinds: Sequence[str]
) -> MeasuringNode:
    """Start a measuring node and its echo in environments of one ROS graph, and wait until they are connected."""
    node = await start(measure, echo, namespace, kinds)
    await node.wait_for_echo(kinds)
    return node


async def start(measure: Environment, echo: Environment, namespace: str, kinds: Sequence[str]) -> MeasuringNode:
    """Start a measuring node and its echo.

    Args:
        measure: Environment of the measuring node.
        echo: Environment of the echo.
        namespace: Namespace of both.
        kinds: Kinds of messages.
    """
    echoes = " ".join(f"{kind}:{kind}" for kind in kinds)
    await echo.add_node(f"{namespace}_echo", PACKAGE, "echo", args=echoes, namespace=namespace)
    await measure.add_node(f"{namespace}_measure", PACKAGE, "measure", args=" ".join(kinds), namespace=namespace)
    orders = await measure.publisher(f"/{namespace}/order", "std_msgs/String")
    reports = await measure.subscriber(f"/{namespace}/report", "std_msgs/String")
    return MeasuringNode(orders, reports)


class MeasuringNode:
    """Client of a node `measure`, which measures a round trip for each order."""

    def __init__(self, orders: Publisher, reports: Subscriber) -> None:
        """Use these topics of the node."""
        self._orders = orders
        self._reports = reports
        self._numbers = itertools.count(1)

    def probes(self, route: str, kinds: Sequence[str], beside: str = "") -> list[Probe]:
        """Return the probes of a route, to be compared with those of the route `beside`."""
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

    async def wait_for_echo(self, kinds: Sequence[str]) -> None:
        """Wait until the two nodes are connected on each topic and service.

        Raises:
            TimedOut: They are not within ECHO_TIMEOUT.
        """
        for kind in kinds:
            await retry(partial(self._order, kind, ROW))
        await drain(self._reports)

    async def _order(self, kind: str, size: int, timeout: float) -> float:  # noqa: ASYNC109  # as Subscriber.get
        """Order one round trip; return its seconds."""
        number = next(self._numbers)
        await self._orders.publish({"data": json.dumps({"number": number, "kind": kind, "size": size})})
        while True:
            report = json.loads((await self._reports.get(timeout))["data"])
            if report["number"] == number:
                return float(report["seconds"])


async def retry(attempt: Callable[[float], Awaitable[object]]) -> None:
    """Repeat an attempt until it is answered: nodes need time to start and to discover each other.

    Raises:
        TimedOut: There is no answer within ECHO_TIMEOUT.
    """
    for _ in range(round(ECHO_TIMEOUT / RETRY_INTERVAL)):
        try:
            await attempt(RETRY_INTERVAL)
            return
        except TimedOut:
            continue
    raise TimedOut(f"the nodes of the benchmark did not answer within {ECHO_TIMEOUT:g} s")


async def drain(subscriber: Subscriber) -> None:
    """Discard late answers to attempts that timed out, so that later ones are not confused with them."""
    try:
        while True:
            await subscriber.get(RETRY_INTERVAL)
    except TimedOut:
        return
