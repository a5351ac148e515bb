"""Routes of gateways: clients of rosbridge and Foxglove beside the robot's JSON and Forwarders, with the same nodes."""

from __future__ import annotations

import asyncio
import time
from collections import defaultdict
from collections.abc import Awaitable, Callable, Sized
from contextlib import suppress
from typing import Any

import msgspec
from websockets.asyncio.client import ClientConnection
from websockets.typing import Subprotocol

from rce.bench.floors import Sample
from rce.bench.nodes import PACKAGE, Place, Probe, retry
from rce.bench.payloads import IMAGE, IMAGES, ROW, TOPICS, Payload
from rce.client.gateways import dial_gateway
from rce.errors import ConversionError, InvalidRequest, TimedOut

QUIET = 1.0  # seconds
SUBPROTOCOL = Subprotocol("foxglove.sdk.v1")
CDR = next(payload for payload in TOPICS if payload.name == "forwarder")
JSON = tuple(payload for payload in (*TOPICS, *IMAGES) if payload.name in ("json", "image_json"))


async def rosbridge(place: Place) -> list[Probe]:
    """Return the probes of a client of rosbridge, each beside that of the route r2c.

    Raises:
        InvalidRequest: The place has no address of the platform.
    """
    if place.address is None:
        raise InvalidRequest("the route rosbridge needs the address of the platform")
    echoes = " ".join(f"{payload.name}:{payload.kind}" for payload in JSON)
    await place.environment.add_node("rosbridge_echo", PACKAGE, "echo", args=echoes, namespace="rosbridge")
    socket = await dial_gateway(place.address, "rosbridge", place.environment.tag)
    await place.stack.enter_async_context(socket)
    client = RosbridgeClient(socket)
    return [
        Probe(
            f"rosbridge {payload.name}",
            "topic",
            await topic_echo(client, payload, f"/rosbridge/{payload.name}"),
            f"r2c {payload.name}",
            IMAGE if payload in IMAGES else None,
        )
        for payload in JSON
    ]


async def foxglove(place: Place) -> list[Probe]:
    """Return the probe of a client of Foxglove, which exchanges CDR, beside that of the route r2c.

    Raises:
        InvalidRequest: The place has no address of the platform.
    """
    if place.address is None:
        raise InvalidRequest("the route foxglove needs the address of the platform")
    args = f"{CDR.name}:{CDR.kind}"
    await place.environment.add_node("foxglove_echo", PACKAGE, "echo", args=args, namespace="foxglove")
    socket = await dial_gateway(place.address, "foxglove", place.environment.tag, [SUBPROTOCOL])
    await place.stack.enter_async_context(socket)
    sample = await channel_echo(FoxgloveClient(socket), f"/foxglove/{CDR.name}")
    return [Probe(f"foxglove {CDR.name}", "topic", sample, f"r2c {CDR.name}")]


class FoxgloveClient:
    """A client of Foxglove that publishes on one channel and reads another."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket

    async def open(self, topic: str, back: str, type_name: str) -> None:
        """Advertise a topic, and subscribe to another once there is a channel for it."""
        channel = {"id": 1, "topic": topic, "encoding": "cdr", "schemaName": type_name}
        await self._send(op="advertise", channels=[channel])
        while True:
            received = await self._socket.recv(decode=False)
            channels = msgspec.json.decode(received).get("channels", []) if received.startswith(b"{") else []
            for each in channels:
                if each["topic"] == back:
                    await self._send(op="subscribe", subscriptions=[{"id": 1, "channelId": each["id"]}])
                    return

    async def _send(self, **message: Any) -> None:
        await self._socket.send(msgspec.json.encode(message), text=True)

    async def publish(self, payload: bytes) -> None:
        """Publish CDR."""
        await self._socket.send(b"\x01\x01\0\0\0" + payload)

    async def message(self) -> memoryview:
        """Return the next message."""
        while not (received := await self._socket.recv(decode=False)).startswith(b"\x01"):
            pass
        return memoryview(received)[13:]

    async def drain(self) -> None:
        """Discard late answers to messages that were sent again while nodes started."""
        await _drain(self._socket)


async def channel_echo(client: FoxgloveClient, topic: str) -> Sample:
    """Return the sample function that publishes on `topic` and waits for the answer on `topic`_back."""
    await client.open(topic, f"{topic}_back", CDR.type_name)

    async def exchange(size: int) -> Sized:
        await client.publish(CDR.make(size))
        return await client.message()

    return await _sample_function(client, topic, exchange)


class RosbridgeClient:
    """A client of rosbridge that reads what it waits for."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._received: defaultdict[str, list[Any]] = defaultdict(list)

    async def send(self, **operation: Any) -> None:
        """Send an operation."""
        await self._socket.send(msgspec.json.encode(operation), text=True)

    async def message(self, topic: str) -> Any:
        """Return the next message of a topic."""
        while not self._received[topic]:
            operation = msgspec.json.decode(await self._socket.recv(decode=False))
            self._received[operation.get("topic", "")].append(operation.get("msg"))
        return self._received[topic].pop(0)

    async def drain(self) -> None:
        """Discard late answers to messages that were sent again while nodes started."""
        await _drain(self._socket)
        self._received.clear()


async def topic_echo(client: RosbridgeClient, payload: Payload, topic: str) -> Sample:
    """Return the sample function that publishes on `topic` and waits for the answer on `topic`_back."""
    await client.send(op="subscribe", topic=f"{topic}_back", type=payload.type_name)
    await client.send(op="advertise", topic=topic, type=payload.type_name)

    async def exchange(size: int) -> Sized:
        await client.send(op="publish", topic=topic, msg=payload.make(size))
        content: Sized = payload.read(await client.message(f"{topic}_back"))
        return content

    return await _sample_function(client, topic, exchange)


async def _sample_function(
    client: FoxgloveClient | RosbridgeClient, topic: str, exchange: Callable[[int], Awaitable[Sized]]
) -> Sample:
    """Return the function that measures an exchange, which returns the content of the answer, once it works."""

    async def sample(size: int) -> float:
        started = time.perf_counter()
        content = await exchange(size)
        seconds = time.perf_counter() - started
        if len(content) < size:
            raise ConversionError(f"{topic}: the answer has {len(content)} of {size} bytes")
        return seconds

    await retry(lambda timeout: _within(sample, timeout))
    await client.drain()
    return sample


async def _drain(socket: ClientConnection) -> None:
    """Read until nothing has come for QUIET seconds."""
    with suppress(TimeoutError):
        async with asyncio.timeout(QUIET):
            while True:
                await socket.recv(decode=False)


async def _within(sample: Sample, timeout: float) -> float:  # noqa: ASYNC109  # as `Subscriber.get`
    try:
        async with asyncio.timeout(timeout):
            return await sample(ROW)
    except TimeoutError:
        raise TimedOut("no answer") from None
