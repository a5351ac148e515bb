"""Program of the robot: it sends and receives the streams, and prints what arrived as JSON.

Mode `rce` uses the client library. Mode `plain` is the comparison: JSON over one WebSocket, in the order in which the
messages are made, as clients of rosbridge do; it has no priorities, and a new session after each loss.
"""

from __future__ import annotations

import argparse
import asyncio
import hashlib
import json
import sys
import time
from contextlib import suppress
from typing import Any
from urllib.parse import urlencode

import msgspec
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, WebSocketException

from rce.bench.network import streams
from rce.bench.network.streams import STREAMS, Arrivals, StreamSpec
from rce.client import Robot
from rce.client.address import Address
from rce.errors import RceError

MODES = ("rce", "plain")
UP = [stream for stream in STREAMS if stream.up]
DOWN = [stream for stream in STREAMS if not stream.up]
RETRY = 0.5  # seconds until a plain client connects again


async def ticks(period: float, until: float) -> Any:
    """Yield at each multiple of the period; late ones are left out."""
    due = time.monotonic()
    while (now := time.monotonic()) < until:
        if due > now:
            await asyncio.sleep(due - now)
        yield
        due = max(due + period, time.monotonic())


# --- with the client library ------------------------------------------------------------------------------------------


async def run_rce(args: argparse.Namespace, found: dict[str, Arrivals]) -> None:
    """Use the client library."""
    until = time.monotonic() + args.seconds
    async with Robot(args.url, user=args.user, robot=streams.ROBOT, password=args.password) as robot:
        for stream in DOWN:
            note = found[stream.name].add_cdr
            await robot.subscriber(stream.name, streams.TYPE, raw=True, delivery=stream.delivery, callback=note)
        publishers = {
            stream.name: await robot.publisher(stream.name, streams.TYPE, raw=True, delivery=stream.delivery)
            for stream in UP
        }
        client = await robot.service_client(streams.SERVICE, streams.SERVICE_TYPE)
        print("ready", flush=True)
        async with asyncio.TaskGroup() as group:
            for stream in UP:
                group.create_task(_send(stream, publishers[stream.name], until))
            group.create_task(_call(client, found[streams.SERVICE], until))


async def _send(stream: StreamSpec, publisher: Any, until: float) -> None:
    async for _ in ticks(stream.period, until):
        await publisher.publish(streams.cdr(stream.size), wait=False)


async def _call(client: Any, arrivals: Arrivals, until: float) -> None:
    async for _ in ticks(streams.SERVICE_PERIOD, until):
        began = time.monotonic()
        with suppress(RceError):
            await client.call({"data": True}, timeout=max(0.1, until - began))
            arrivals.add(began)


# --- as plain JSON ----------------------------------------------------------------------------------------------------


class Plain:
    """Client that writes JSON to one socket in the order in which it is made."""

    def __init__(self, args: argparse.Namespace, found: dict[str, Arrivals]) -> None:
        self._address = Address(args.url, args.user, streams.ROBOT, args.password)
        digest = hashlib.sha256(args.password.encode()).hexdigest()
        self._query = urlencode({"userID": args.user, "robotID": streams.ROBOT, "password": digest})
        self._found = found
        self._socket: ClientConnection | None = None
        self._calls: dict[str, float] = {}
        self._until = time.monotonic() + args.seconds

    async def run(self) -> None:
        """Send and receive until the end, with a new connection after each loss."""
        senders = [asyncio.create_task(self._send(stream)) for stream in UP]
        senders.append(asyncio.create_task(self._call()))
        try:
            while time.monotonic() < self._until:
                with suppress(RceError, OSError, WebSocketException, TimeoutError):
                    async with asyncio.timeout(self._until - time.monotonic()):
                        await self._connection()
                self._socket = None
                await asyncio.sleep(RETRY)
        finally:
            for sender in senders:
                sender.cancel()

    async def _connection(self) -> None:
        endpoint = await self._address.locate()
        socket = await connect(f"{endpoint}?{self._query}", compression=None, proxy=None)
        try:
            await self._declare(socket)
            self._socket = socket
            print("ready", flush=True)
            with suppress(ConnectionClosed):
                while True:
                    self._receive(json.loads(await socket.recv()))
        finally:
            self._socket = None
            socket.transport.abort()

    async def _declare(self, socket: ClientConnection) -> None:
        kinds = [(stream.name, "SubscriberConverter" if stream.up else "PublisherConverter") for stream in STREAMS]
        added = [
            {"endpointTag": streams.ROBOT, "interfaceTag": name, "interfaceType": kind, "className": streams.TYPE}
            for name, kind in kinds
        ]
        service = {"interfaceTag": streams.SERVICE, "interfaceType": "ServiceProviderConverter"}
        added.append({"endpointTag": streams.ROBOT, "className": streams.SERVICE_TYPE} | service)
        await socket.send(json.dumps({"type": "CN", "data": {"addInterfaces": added}}))

    async def _message(self, tag: str, kind: str, id: str, value: Any) -> bool:
        """Send a data message; return False while there is no connection."""
        data = {"iTag": tag, "type": kind, "msgID": id, "msg": value}
        if self._socket is None:
            return False
        with suppress(ConnectionClosed):
            await self._socket.send(json.dumps({"type": "DM", "data": data}))
            return True
        return False

    async def _send(self, stream: StreamSpec) -> None:
        size = int(stream.size * streams.PLAIN_MARGIN)
        async for _ in ticks(stream.period, self._until):
            await self._message(stream.name, streams.TYPE, "nil", {"data": streams.text(size)})

    async def _call(self) -> None:
        number = 0
        async for _ in ticks(streams.SERVICE_PERIOD, self._until):
            number += 1
            self._calls[str(number)] = time.monotonic()
            await self._message(streams.SERVICE, streams.SERVICE_TYPE, str(number), {"data": True})

    def _receive(self, frame: dict[str, Any]) -> None:
        data = frame["data"]
        if frame["type"] != "DM":
            return
        if data["iTag"] == streams.SERVICE:
            began = self._calls.pop(data["msgID"], None)
            if began is not None:
                self._found[streams.SERVICE].add(began)
        else:
            self._found[data["iTag"]].add(streams.sent_at(data["msg"]["data"]))


async def run(args: argparse.Namespace) -> dict[str, Arrivals]:
    """Run one of the modes; return what arrived, by stream."""
    found = {name: Arrivals() for name in (*(stream.name for stream in STREAMS), streams.SERVICE)}
    if args.mode == "rce":
        await run_rce(args, found)
    else:
        await Plain(args, found).run()
    return found


def main() -> None:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--url", required=True)
    parser.add_argument("--user", required=True)
    parser.add_argument("--password", required=True)
    parser.add_argument("--mode", choices=MODES, required=True)
    parser.add_argument("--seconds", type=float, required=True)
    sys.stdout.buffer.write(msgspec.json.encode(asyncio.run(run(parser.parse_args()))) + b"\n")


if __name__ == "__main__":
    main()
