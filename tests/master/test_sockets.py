"""WebSockets at the entry, without a network."""

from __future__ import annotations

from twisted.internet.testing import StringTransport
from websockets.frames import Frame, Opcode

from master.api.sockets import Socket

HANDSHAKE = (
    b"GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: MTIzNDU2Nzg5MDEyMzQ1Ng==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


class Silent:
    def received(self, text: bytes) -> None: ...

    def room(self) -> None: ...

    def closed(self) -> None: ...


async def test_nothing_is_taken_from_who_does_not_read() -> None:
    """Their pings would be answered, and the answers kept."""
    socket, transport = Socket(lambda _: Silent()), StringTransport()
    socket.makeConnection(transport)  # type: ignore[no-untyped-call]  # Twisted's
    socket.dataReceived(HANDSHAKE)
    transport.clear()
    socket.dataReceived(Frame(Opcode.PING, b"?").serialize(mask=True))
    assert transport.value() == Frame(Opcode.PONG, b"?").serialize(mask=False)
    assert transport.producer is socket
    socket.pauseProducing()
    assert transport.producerState == "paused"
    socket.resumeProducing()
    assert transport.producerState == "producing"
    socket.connectionLost()
