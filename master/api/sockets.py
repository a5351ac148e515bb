"""WebSockets on the port of the entry: a request's connection is taken over, frames are those of `websockets`.

The part of `websockets` without I/O is used because Autobahn, which serves robots, can be on one of Twisted and asyncio
in a process, and tests have both ends in one.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, Protocol

from twisted.internet.protocol import Protocol as TwistedProtocol
from twisted.python.failure import Failure
from twisted.web.resource import Resource
from twisted.web.server import NOT_DONE_YET, Request
from websockets.frames import Frame, Opcode
from websockets.http11 import Request as Handshake
from websockets.protocol import OPEN
from websockets.server import ServerProtocol

from master.api.problems import refuse
from rce.errors import InvalidRequest

MOST = 65_536  # bytes of a message that is taken
PING = 20.0  # seconds; who has not answered a ping when the next is due is gone
POLICY = 1008  # close code


class UpgradeRequired(InvalidRequest):
    """This is for WebSockets only."""

    code = "upgrade_required"


class Listener(Protocol):
    """What becomes of a socket."""

    def received(self, text: bytes) -> None:
        """A text message."""

    def room(self) -> None:
        """What was written has left: there is room for more."""

    def closed(self) -> None:
        """It is gone."""


class Socket(TwistedProtocol):
    """One WebSocket, and a push producer of Twisted's. `full` while what was sent has not left."""

    def __init__(self, listener: Callable[[Socket], Listener]) -> None:
        self.full = False
        self._protocol = ServerProtocol(max_size=MOST)
        self._listener = listener(self)
        self._answered = True
        self._ping: asyncio.TimerHandle | None = None

    @property
    def address(self) -> str:
        """Who is at the other end."""
        return str(getattr(self._transport.getPeer(), "host", ""))

    def send(self, text: bytes) -> None:
        if self._protocol.state is OPEN:
            self._protocol.send_text(text)
            self._flush()

    def close(self, code: int, reason: str) -> None:
        if self._protocol.state is OPEN:
            self._protocol.send_close(code, reason.encode()[:120].decode(errors="ignore"))
            self._flush()

    # --- Twisted's ----------------------------------------------------------------------------------------------------

    def connectionMade(self) -> None:
        self._transport.registerProducer(self, True)
        self._ping = asyncio.get_running_loop().call_later(PING, self._tick)

    def dataReceived(self, data: bytes) -> None:
        self._answered = True
        self._protocol.receive_data(data)
        for event in self._protocol.events_received():
            if isinstance(event, Handshake):
                self._protocol.send_response(self._protocol.accept(event))
            elif isinstance(event, Frame) and event.opcode in (Opcode.TEXT, Opcode.BINARY, Opcode.CONT):
                if event.opcode is Opcode.TEXT and event.fin:
                    self._listener.received(bytes(event.data))
                else:
                    self.close(POLICY, "one text message in one frame is taken, no other")
        self._flush()

    def connectionLost(self, reason: Failure | None = None) -> None:
        if self._ping is not None:
            self._ping.cancel()
        self._listener.closed()

    def pauseProducing(self) -> None:
        """Nothing is read either: each ping would be answered, and the answers would wait here."""
        self.full = True
        self._transport.pauseProducing()

    def resumeProducing(self) -> None:
        self.full = False
        self._transport.resumeProducing()
        self._listener.room()

    def stopProducing(self) -> None:
        self.full = True

    @property
    def _transport(self) -> Any:  # what of it is needed is in no one interface of Twisted's
        return self.transport

    def _flush(self) -> None:
        for data in self._protocol.data_to_send():
            if data:
                self._transport.write(data)
            else:
                self._transport.loseConnection()
        if self._protocol.close_expected():
            self._transport.loseConnection()

    def _tick(self) -> None:
        if not self._answered:
            self._transport.abortConnection()
            return
        self._answered = False
        if self._protocol.state is OPEN:
            self._protocol.send_ping(b"")
            self._flush()
        self._ping = asyncio.get_running_loop().call_later(PING, self._tick)


class SocketResource(Resource):
    """`listener` makes what hears a new socket."""

    isLeaf = True

    def __init__(self, listener: Callable[[Socket], Listener]) -> None:
        super().__init__()  # type: ignore[no-untyped-call]  # Twisted's
        self._listener = listener

    def render(self, request: Request) -> int:
        if "websocket" not in (request.getHeader("upgrade") or "").lower() or request.method != b"GET":
            request.setHeader("upgrade", "websocket")
            refuse(request, UpgradeRequired("this is for WebSockets: connect with ws:// or wss://"))
            return NOT_DONE_YET
        socket = Socket(self._listener)
        channel: Any = request.channel
        transport, channel.transport = channel.transport, None
        channel.setTimeout(None)
        transport.unregisterProducer()
        # Under TLS it is the wrapper that has the protocol, and the wrapper may be the transport or its protocol.
        holder = next((each for each in (transport, transport.protocol) if hasattr(each, "wrappedProtocol")), None)
        setattr(holder or transport, "wrappedProtocol" if holder else "protocol", socket)
        socket.makeConnection(transport)  # type: ignore[no-untyped-call]  # Twisted's
        transport.resumeProducing()  # it was paused for the time of the request
        socket.dataReceived(_again(request))
        return NOT_DONE_YET


def _again(request: Request) -> bytes:
    """The request as it came: websockets reads it itself."""
    lines = [b" ".join([request.method, request.uri, b"HTTP/1.1"])]
    for name, values in request.requestHeaders.getAllRawHeaders():
        lines.append(name + b": " + b", ".join(values))
    return b"\r\n".join(lines) + b"\r\n\r\n"
