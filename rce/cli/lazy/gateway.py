"""Implementation of `gateway`: local ports for clients of rosbridge and Foxglove that can give neither path nor key."""

from __future__ import annotations

import argparse
import asyncio
import signal
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from functools import partial
from urllib.parse import parse_qsl, urlsplit

from websockets.asyncio.client import ClientConnection
from websockets.asyncio.connection import Connection
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.typing import Subprotocol

from rce.cli.session import ConsoleSession
from rce.client.address import Address
from rce.client.gateways import dial_gateway
from rce.errors import RceError, port_unavailable

HOST = "127.0.0.1"
MAX_MESSAGE = 80 * 1024 * 1024  # bytes; the endpoint's own limit is the one that a client notices
SUBPROTOCOLS = {
    "rosbridge": None,
    "foxglove": [Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1")],
}
REFUSED = 1011  # close code of a connection that cannot be forwarded


Dial = Callable[[Sequence[Subprotocol] | None, Sequence[tuple[str, str]]], Awaitable[ClientConnection]]
"""Opens a connection to the gateway, given subprotocols and options; raises RceError."""


async def forward(dial: Dial, client: ServerConnection) -> None:
    """Connect a client with the gateway until one of the two closes its connection."""
    offered = [Subprotocol(client.subprotocol)] if client.subprotocol else None
    try:
        gateway = await dial(offered, _options(client))
    except RceError as error:
        print(f"a client was refused: {error}", flush=True)
        await client.close(REFUSED, str(error).encode()[:120].decode(errors="ignore"))
        return
    ways = [asyncio.create_task(_pass(client, gateway)), asyncio.create_task(_pass(gateway, client))]
    try:
        await asyncio.wait(ways)
    finally:
        for way in ways:
            way.cancel()


def _options(client: ServerConnection) -> list[tuple[str, str]]:
    """Return the options in the URL of a client, as `codec` in `ws://127.0.0.1:8765/?codec=draco`."""
    request = client.request
    return parse_qsl(urlsplit(request.path).query) if request is not None else []


async def _pass(source: Connection, sink: Connection) -> None:
    """Pass messages on; at the end close the other connection in the same way."""
    try:
        async for message in source:
            await sink.send(message)
    except ConnectionClosed:
        pass  # of the sink; or of the source, which failed
    code = source.close_code
    usable = code is not None and (code in (1000, 1001, 1003, 1007, 1008, 1009, 1011) or code >= 3000)
    await sink.close(code if usable and code is not None else 1001, source.close_reason or "")


@asynccontextmanager
async def opened(dial: Dial, port: int, subprotocols: list[Subprotocol] | None = None) -> AsyncIterator[int]:
    """Serve a port without credentials on loopback; yield its number.

    Raises:
        Unavailable: The port is in use.
    """
    try:
        server = await serve(
            partial(forward, dial), HOST, port, compression=None, max_size=MAX_MESSAGE, subprotocols=subprotocols
        )
    except OSError as error:
        raise port_unavailable(HOST, port, error) from None
    async with server:
        yield int(next(iter(server.sockets)).getsockname()[1])


async def run(session: ConsoleSession, args: argparse.Namespace) -> int:
    """Serve the ports until Ctrl-C."""
    access, stopped = session.access, asyncio.Event()
    address = Address(access.url, session.user, "", access.password, access.key, owner=args.of)
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stopped.set)
    async with AsyncExitStack() as stack:
        tried = await dial_gateway(address, "rosbridge", args.environment)  # so that a wrong name is reported now
        await tried.close()
        ports = {"rosbridge": args.rosbridge_port, "foxglove": args.foxglove_port}
        for protocol, wanted in ports.items():
            dial = partial(dial_gateway, address, protocol, args.environment)
            port = await stack.enter_async_context(opened(dial, wanted, SUBPROTOCOLS[protocol]))
            print(f"{protocol}: ws://{HOST}:{port}", flush=True)
        await stopped.wait()
    return 0


def gateway(session: ConsoleSession, args: argparse.Namespace) -> int:
    """Run `gateway`."""
    return asyncio.run(run(session, args))
