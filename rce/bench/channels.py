"""Benchmark of a Foxglove client that subscribes to a large topic and, beside it, to a small one.

The messages have numbers, by which lost ones are counted, and the time by the monotonic clock: client and nodes must be
on one machine.
"""

from __future__ import annotations

import asyncio
import statistics
import struct
import time
from typing import Any

import msgspec
from msgspec import Struct, to_builtins
from websockets.asyncio.client import ClientConnection

from rce.bench.gateways import SUBPROTOCOL
from rce.bench.nodes import PACKAGE, Place
from rce.bench.report import aligned, machine
from rce.bench.statistics import percentile
from rce.client.gateways import dial_gateway
from rce.errors import InvalidRequest, TimedOut

START_TIMEOUT = 60.0  # seconds until both channels are there and have a message
SETTLED = 2.0  # seconds after the first message that are not counted
MILLI = 1e3
MESSAGE = struct.Struct("<BIQ")  # opcode, subscription, time
CONTENT = struct.Struct("<Qd")  # number, time
OFFSET = 16  # bytes of CDR before the data


class Stream(Struct, frozen=True):
    """A topic: messages a second, and bytes of a message."""

    name: str
    rate: float
    size: int


STREAMS = (Stream("large", 100, 1_000_000), Stream("small", 10, 100))


class Received(Struct):
    """Messages of a stream that arrived: their delays in seconds, and how many are missing."""

    stream: Stream
    delays: list[float] = []
    missing: int = 0
    last: int = -1

    def add(self, number: int, sent: float, now: float) -> None:
        """Count a message."""
        if self.last >= 0:
            self.missing += max(0, number - self.last - 1)
        self.last = number
        self.delays.append(now - sent)


async def measure(place: Place, seconds: float) -> list[Received]:
    """Measure the streams for some seconds.

    Raises:
        InvalidRequest: The place has no address of the platform.
        TimedOut: The streams do not arrive.
    """
    if place.address is None:
        raise InvalidRequest("a client of Foxglove needs the address of the platform")
    for stream in STREAMS:
        args = f"/{stream.name} {stream.rate} {stream.size}"
        await place.environment.add_node(stream.name, PACKAGE, "stream", args=args)
    socket = await dial_gateway(place.address, "foxglove", place.environment.tag, [SUBPROTOCOL])
    async with socket:
        try:
            async with asyncio.timeout(START_TIMEOUT):
                await subscribe(socket)
        except TimeoutError:
            raise TimedOut(f"the topics of the nodes were not there within {START_TIMEOUT:g} s") from None
        await receive(socket, SETTLED)
        return await receive(socket, seconds)


async def subscribe(socket: ClientConnection) -> None:
    """Subscribe to all streams as soon as they are channels; return when each has sent something."""
    missing = {f"/{stream.name}": number for number, stream in enumerate(STREAMS)}
    silent = set(range(len(STREAMS)))
    while silent:
        received = await socket.recv(decode=False)
        if received.startswith(b"\x01"):
            silent.discard(MESSAGE.unpack_from(received)[1])
            continue
        for channel in msgspec.json.decode(received).get("channels", []):
            number = missing.pop(channel["topic"], None)
            if number is not None:
                wanted = {"op": "subscribe", "subscriptions": [{"id": number, "channelId": channel["id"]}]}
                await socket.send(msgspec.json.encode(wanted), text=True)


async def receive(socket: ClientConnection, seconds: float) -> list[Received]:
    """Return what arrives within some seconds."""
    found = [Received(stream) for stream in STREAMS]
    until = time.monotonic() + seconds
    while (left := until - time.monotonic()) > 0:
        try:
            async with asyncio.timeout(left):
                message = await socket.recv(decode=False)
        except TimeoutError:
            break
        now = time.monotonic()
        if message.startswith(b"\x01"):
            stream = MESSAGE.unpack_from(message)[1]
            found[stream].add(*CONTENT.unpack_from(message, MESSAGE.size + OFFSET), now)
    return found


def as_data(result: list[Received], seconds: float) -> dict[str, Any]:
    """Return all delays for JSON."""
    data: dict[str, Any] = to_builtins({"machine": machine(), "seconds": seconds, "channels": result})
    return data


def as_text(result: list[Received], seconds: float) -> str:
    """Return a table in milliseconds."""
    rows = [["topic", "published, Hz", "bytes", "received, Hz", "missing", "delay, ms: p50", "p99", "most"]]
    for each in result:
        stream, delays = each.stream, each.delays or [float("nan")]
        figures = (statistics.median(delays), percentile(delays, 99), max(delays))
        counts = [f"{stream.rate:g}", f"{stream.size}", f"{len(each.delays) / seconds:.1f}", f"{each.missing}"]
        rows.append([stream.name, *counts, *(f"{figure * MILLI:.1f}" for figure in figures)])
    return "\n".join(aligned(rows))
