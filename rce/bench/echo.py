"""Echo server of the bare echoes: `python -m rce.bench.echo tcp|autobahn`.

It prints its port. Needs the extra `server`.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from typing import cast

import txaio
import uvloop

from rce.bench.floors import MAX_SIZE, enlarge_buffers

txaio.use_asyncio()  # before Autobahn is imported, which reads this only once
from autobahn.asyncio.websocket import WebSocketServerFactory, WebSocketServerProtocol  # noqa: E402

READ = 1024 * 1024  # bytes of the receive buffer


class TcpEcho(asyncio.BufferedProtocol):
    """Echo of a byte stream."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Prepare the buffers."""
        self._transport = cast(asyncio.Transport, transport)
        self._buffer = memoryview(bytearray(READ))
        enlarge_buffers(transport.get_extra_info("socket"))

    def get_buffer(self, sizehint: int) -> memoryview:
        """Return the receive buffer."""
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        """Send the received bytes back."""
        self._transport.write(bytes(self._buffer[:nbytes]))


class WebSocketEcho(WebSocketServerProtocol):
    """Echo of WebSocket messages."""

    def onOpen(self) -> None:
        """Prepare the socket."""
        enlarge_buffers(self.transport.get_extra_info("socket"))

    def onMessage(self, payload: bytes, isBinary: bool) -> None:
        """Send a message back."""
        self.sendMessage(payload, isBinary)  # type: ignore[no-untyped-call]


def autobahn(loop: asyncio.AbstractEventLoop) -> WebSocketServerFactory:
    """Return the factory of the WebSocket echo."""
    factory = WebSocketServerFactory(loop=loop)
    factory.protocol = WebSocketEcho
    factory.setProtocolOptions(maxMessagePayloadSize=MAX_SIZE, maxFramePayloadSize=MAX_SIZE)
    return factory


async def serve(kind: str) -> None:
    """Run the echo server `tcp` or `autobahn` on a free port and print the port."""
    loop = asyncio.get_running_loop()
    make: Callable[[], asyncio.BaseProtocol] = TcpEcho if kind == "tcp" else autobahn(loop)
    server = await loop.create_server(make, "127.0.0.1", 0)
    print(server.sockets[0].getsockname()[1], flush=True)
    await server.serve_forever()


if __name__ == "__main__":
    uvloop.run(serve(sys.argv[1]))
