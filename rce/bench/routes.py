"""Routes of round trips; each returns one probe for each form of a message."""

from __future__ import annotations

import time
from asyncio import gather
from collections.abc import Awaitable, Callable, Sized

from rce.bench import cpp, floors, gateways, pairs
from rce.bench.floors import Sample
from rce.bench.nodes import ECHO_TIMEOUT, PACKAGE, Place, Probe, drain, retry, start_connected
from rce.bench.payloads import IMAGE, IMAGES, ROW, SERVICE_TYPE, SERVICES, TOPICS, Call, Payload
from rce.client import Publisher, Subscriber
from rce.errors import ConversionError


async def tcp(place: Place) -> list[Probe]:
    """Return the probe of a bare echo over a TCP connection."""
    return [Probe("tcp", "floor", await place.stack.enter_async_context(floors.tcp()))]


async def autobahn(place: Place) -> list[Probe]:
    """Return the probe of a bare echo of binary WebSocket messages by Autobahn."""
    return [Probe("autobahn", "floor", await place.stack.enter_async_context(floors.autobahn()))]


async def n2n(place: Place) -> list[Probe]:
    """Return the probes between two rclpy nodes in the environment."""
    kinds = ["string", "bytes", "image", "service"]
    node = await start_connected(place.environment, place.environment, "n2n", kinds)
    return node.probes("n2n", kinds)


async def r2c(place: Place) -> list[Probe]:
    """Return the probes between the robot and a node in the environment."""
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


async def r2r(place: Place) -> list[Probe]:
    """Return the probes between two interfaces of the robot, without an environment."""
    probes = []
    for payload in TOPICS:
        tag = f"r2r_{payload.name}"
        back = await place.robot.subscriber(f"{tag}_back", payload.type_name, raw=payload.raw)
        out = await place.robot.publisher(tag, payload.type_name, to=f"{place.robot.name}/{tag}_back", raw=payload.raw)
        probes.append(Probe(f"r2r {payload.name}", "topic", await round_trips(out, back, payload, tag)))
    return probes


ROUTES: dict[str, Callable[[Place], Awaitable[list[Probe]]]] = {
    "tcp": tcp,
    "autobahn": autobahn,
    "n2n": n2n,
    "r2c": r2c,
    "r2r": r2r,
    "c2c": pairs.c2c,
    "c2c2": pairs.c2c2,
    "group": pairs.group,
    "rosbridge": gateways.rosbridge,
    "foxglove": gateways.foxglove,
    "cpp": cpp.cpp,
}
DEFAULT_ROUTES = ("tcp", "autobahn", "n2n", "r2c")


async def topic_echo(place: Place, payload: Payload, topic: str) -> Sample:
    """Return the sample function that publishes on `topic` and waits for the answer on `topic`_back."""
    out = await place.environment.publisher(topic, payload.type_name, raw=payload.raw)
    back = await subscriber(place, payload, f"{topic}_back")
    return await round_trips(out, back, payload, topic)


async def round_trips(out: Publisher, back: Subscriber, payload: Payload, where: str) -> Sample:
    """Return the sample function that publishes and waits for the answer, once there are answers."""

    async def take(size: int, timeout: float) -> float:  # noqa: ASYNC109  # as Subscriber.get
        started = time.perf_counter()
        await out.publish(payload.make(size))
        content = payload.read(await back.get(timeout))
        seconds = time.perf_counter() - started
        check(where, content, size)
        return seconds

    await retry(lambda timeout: take(ROW, timeout))
    await drain(back)
    return lambda size: take(size, ECHO_TIMEOUT)


async def subscriber(place: Place, payload: Payload, topic: str) -> Subscriber:
    """Create a subscriber as `Environment.subscriber`, with a choice of the format of images."""
    robot, environment, tag = place.robot, place.environment.tag, f"back_{payload.name}"
    await robot.add_interface(environment, tag, "SubscriberInterface", payload.type_name, addr=topic)
    return await robot.subscriber(
        tag, payload.type_name, to=f"{environment}/{tag}", raw=payload.raw, format=payload.format
    )


async def service_echo(place: Place, call: Call, service: str) -> Sample:
    """Return the sample function that calls `service` and waits for the response."""
    client = await place.environment.service_client(service, SERVICE_TYPE, raw=call.raw)

    async def take(size: int) -> float:
        started = time.perf_counter()
        content = call.read(await client.call(call.make(size), ECHO_TIMEOUT))
        seconds = time.perf_counter() - started
        check(service, content, size)
        return seconds

    await take(ROW)
    return take


def check(where: str, content: Sized, size: int) -> None:
    """Check the size of an answer.

    Raises:
        ConversionError: The answer is shorter than the message.
    """
    if len(content) < size:
        raise ConversionError(f"{where}: the answer has {len(content)} of {size} bytes")
