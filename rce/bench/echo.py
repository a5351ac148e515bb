"""`python -m rce.bench.echo tcp|autobahn`: an echo server, which prints its port. Needs the extra `server`."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from typing import cast

import txaio
import uvloop

from rce.bench.floors import MAX_SIZE, widen

txaio.use_asyncio()  # before Autobahn is imported: it asks once which of the two it runs on
from autobahn.asyncio.websocket import WebSocketServerFactory, WebSocketServerProtocol  # noqa: E402

READ = 1024 * 1024


class TcpEcho(asyncio.BufferedProtocol):
    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self._buffer = memoryview(bytearray(READ))
        widen(transport.get_extra_info("socket"))

    def get_buffer(self, sizehint: int) -> memoryview:
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        self._transport.write(bytes(self._buffer[:nbytes]))


class WebSocketEcho(WebSocketServerProtocol):
    def onOpen(self) -> None:
        widen(self.transport.get_extra_info("socket"))

    def onMessage(self, payload: bytes, isBinary: bool) -> None:
        self.sendMessage(payload, isBinary)  # type: ignore[no-untyped-call]


def autobahn(loop: asyncio.AbstractEventLoop) -> WebSocketServerFactory:
    factory = WebSocketServerFactory(loop=loop)
    factory.protocol = WebSocketEcho
    factory.setProtocolOptions(maxMessagePayloadSize=MAX_SIZE, maxFramePayloadSize=MAX_SIZE)
    return factory


async def serve(kind: str) -> None:
    loop = asyncio.get_running_loop()
    make: Callable[[], asyncio.BaseProtocol] = TcpEcho if kind == "tcp" else autobahn(loop)
    server = await loop.create_server(make, "127.0.0.1", 0)
    print(server.sockets[0].getsockname()[1], flush=True)
    await server.serve_forever()


if __name__ == "__main__":
    uvloop.run(serve(sys.argv[1]))
