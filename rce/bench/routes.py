"""The routes by which round trips are taken; each gives one probe for every form of a message."""

from __future__ import annotations

import itertools
import json
import time
from asyncio import gather
from collections.abc import Awaitable, Callable, Sequence, Sized
from contextlib import AsyncExitStack
from functools import partial
from typing import NamedTuple

from rce.bench import floors
from rce.bench.floors import Sample
from rce.bench.payloads import IMAGE, IMAGES, ROW, SERVICE_TYPE, SERVICES, TOPICS, Call, Payload
from rce.client import Environment, Publisher, Robot, Subscriber
from rce.errors import ConversionError, TimedOut

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


async def tcp(place: Place) -> list[Probe]:
    """A bare echo over a TCP connection."""
    return [Probe("tcp", "floor", await place.stack.enter_async_context(floors.tcp()))]


async def autobahn(place: Place) -> list[Probe]:
    """A bare echo of binary frames by Autobahn."""
    return [Probe("autobahn", "floor", await place.stack.enter_async_context(floors.autobahn()))]


async def n2n(place: Place) -> list[Probe]:
    """Two rclpy nodes in the environment."""
    kinds = ["string", "bytes", "image", "service"]
    environment = place.environment
    echoes = " ".join(f"{kind}:{kind}" for kind in kinds)
    await environment.add_node("n2n_echo", PACKAGE, "echo", args=echoes, namespace="n2n")
    await environment.add_node("n2n_measure", PACKAGE, "measure", args=" ".join(kinds), namespace="n2n")
    orders = await environment.publisher("/n2n/order", "std_msgs/String")
    reports = await environment.subscriber("/n2n/report", "std_msgs/String")
    node = MeasuringNode(orders, reports)
    await node.found(kinds)
    return [
        Probe("n2n string", "topic", node.probe("string")),
        Probe("n2n bytes", "topic", node.probe("bytes")),
        Probe("n2n image", "topic", node.probe("image"), size=IMAGE),
        Probe("n2n service", "service", node.probe("service")),
    ]


async def r2c(place: Place) -> list[Probe]:
    """A robot, and a node in the environment."""
    topics = (*TOPICS, *IMAGES)
    echoes = [f"{payload.name}:{payload.kind}" for payload in topics]
    echoes += [f"call_{call.name}:service" for call in SERVICES]
    await place.environment.add_node("r2c_echo", PACKAGE, "echo", args=" ".join(echoes), namespace="r2c")
    sent = await gather(*(topic_echo(place, payload, f"/r2c/{payload.name}") for payload in topics))
    called = await gather(*(service_echo(place, call, f"/r2c/call_{call.name}") for call in SERVICES))
    probes = [
        Probe(f"r2c {payload.name}", "topic", sample, f"n2n {payload.kind}", IMAGE if payload in IMAGES else None)
        for payload, sample in zip(topics, sent, strict=True)
    ]
    probes += [
        Probe(f"r2c service {call.name}", "service", sample, "n2n service")
        for call, sample in zip(SERVICES, called, strict=True)
    ]
    return probes


ROUTES: dict[str, Callable[[Place], Awaitable[list[Probe]]]] = {
    "tcp": tcp,
    "autobahn": autobahn,
    "n2n": n2n,
    "r2c": r2c,
}


class MeasuringNode:
    """The node `measure`, as ordered by the robot: it takes the round trip and the time."""

    def __init__(self, orders: Publisher, reports: Subscriber) -> None:
        self._orders = orders
        self._reports = reports
        self._numbers = itertools.count(1)

    def probe(self, kind: str) -> Sample:
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


async def topic_echo(place: Place, payload: Payload, topic: str) -> Sample:
    """Publish on `topic` and await the answer on `topic`_back."""
    out = await place.environment.publisher(topic, payload.type_name, raw=payload.raw)
    back = await subscriber(place, payload, f"{topic}_back")

    async def take(size: int, timeout: float) -> float:  # noqa: ASYNC109  # as Subscriber.get
        began = time.perf_counter()
        await out.publish(payload.make(size))
        content = payload.read(await back.get(timeout))
        seconds = time.perf_counter() - began
        check(topic, content, size)
        return seconds

    await eventually(lambda timeout: take(ROW, timeout))
    await drain(back)
    return lambda size: take(size, ECHO_TIMEOUT)


async def subscriber(place: Place, payload: Payload, topic: str) -> Subscriber:
    """As `Environment.subscriber`, with the format in which images come."""
    robot, environment, tag = place.robot, place.environment.tag, f"back_{payload.name}"
    await robot.add_interface(environment, tag, "SubscriberInterface", payload.type_name, addr=topic)
    return await robot.subscriber(
        tag, payload.type_name, to=f"{environment}/{tag}", raw=payload.raw, format=payload.format
    )


async def service_echo(place: Place, call: Call, service: str) -> Sample:
    """Call `service` and await its response."""
    client = await place.environment.service_client(service, SERVICE_TYPE, raw=call.raw)

    async def take(size: int) -> float:
        began = time.perf_counter()
        content = call.read(await client.call(call.make(size), ECHO_TIMEOUT))
        seconds = time.perf_counter() - began
        check(service, content, size)
        return seconds

    await take(ROW)
    return take


def check(where: str, content: Sized, size: int) -> None:
    """ConversionError if the answer is not as large as what was sent."""
    if len(content) < size:
        raise ConversionError(f"{where}: {len(content)} of {size} bytes came back")


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
