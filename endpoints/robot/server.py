"""WebSocket server for robots.

This is the only module that uses Autobahn.
"""

from __future__ import annotations

import asyncio
import time
from typing import Any

import txaio
from twisted.logger import Logger
from websockets.speedups import apply_mask

from endpoints.robot.endpoint import LoginResult, RobotEndpoint
from endpoints.robot.frame_receiver import FrameReceiver
from endpoints.robot.handshake import parse_login, refusal_status, wants_close_code
from endpoints.robot.session import Piece, RobotSession
from rce.errors import RceError
from rce.net.listener import Listener, bind
from rce.net.pending_logins import PendingLogin
from rce.net.sockets import tune
from rce.protocol.blobs import BinaryFrame, Buffer

txaio.use_asyncio()  # before Autobahn is imported, which chooses its framework then
from autobahn.asyncio.websocket import WebSocketServerFactory, WebSocketServerProtocol  # noqa: E402
from autobahn.websocket import protocol  # noqa: E402
from autobahn.websocket.compress import PerMessageDeflateOffer, PerMessageDeflateOfferAccept  # noqa: E402
from autobahn.websocket.types import ConnectionDeny, ConnectionRequest  # noqa: E402

HIGH_WATER = 256 * 1024  # bytes; while the transport holds more, messages wait in the outbox, where they take turns
HANDSHAKE_TIMEOUT = 30.0  # seconds for the opening handshake, with the login
MAX_REQUEST = 64 * 1024  # bytes of the opening HTTP request
CHUNK = 64 * 1024  # bytes; smaller fragments of a message are joined as they come
SLICE = 0.0005  # seconds for which the frames of one robot may be processed at a stretch
TICK = 10.0  # seconds; a robot that is silent for one tick is pinged, after two its socket is closed
NORMAL = 1000  # close code of a normal closure (RFC 6455, section 7.4.1)
TEXT, BINARY = b"\x81", b"\x82"  # first bytes of final frames
REFUSED = 4000  # plus the HTTP status: close code of a refusal after the handshake

log = Logger()


def _accept_deflate(offers: list[Any]) -> PerMessageDeflateOfferAccept | None:
    offer = next((offer for offer in offers if isinstance(offer, PerMessageDeflateOffer)), None)
    return PerMessageDeflateOfferAccept(offer) if offer is not None else None


class _Unmasker:
    """Unmasks a frame (RFC 6455, section 5.3) in one pass over the data; Autobahn's own masker makes four."""

    def __init__(self, mask: Buffer, _length: int) -> None:
        self._mask = bytes(mask)
        self._done = 0

    def pointer(self) -> int:
        return self._done

    def process(self, data: Buffer) -> bytes:
        turn = self._done % 4
        self._done += len(data)
        return apply_mask(data, self._mask[turn:] + self._mask[:turn])


protocol.create_xor_masker = _Unmasker  # type: ignore[attr-defined, assignment]  # its parser takes the function from there


class RobotSocket(WebSocketServerProtocol):
    """WebSocket of one robot."""

    def __init__(self, endpoint: RobotEndpoint, pending: PendingLogin) -> None:
        super().__init__()
        self._endpoint = endpoint
        self._pending = pending
        self._login: LoginResult | None = None
        self._session: RobotSession | None = None
        self._denied: ConnectionDeny | None = None  # refusal to be sent as a close code
        self._full = False
        self._reason = ""
        self._timer: asyncio.TimerHandle | None = None
        self._paused_until: asyncio.Future[None] | None = None  # set while reading is paused
        self._data_received = False  # since the last tick
        self._silent_ticks = 0
        self._unsent = 0  # bytes in the write buffer at the last tick
        self._pending_pong: bytes | None = None  # payload of a ping that came while the write buffer was full

    def connection_lost(self, exc: Exception | None) -> None:
        """Count the connection no longer."""
        self._pending.end()
        super().connection_lost(exc)

    # --- handshake ----------------------------------------------------------------------------------------------------

    async def onConnect(  # type: ignore[override]  # Autobahn accepts a coroutine
        self, request: ConnectionRequest
    ) -> tuple[None, dict[str, str]]:
        """Log the robot in, or refuse the handshake."""
        features: frozenset[str] = frozenset()
        try:
            login = parse_login(request)
            features = login.features
            self._login = await self._endpoint.login(login)
        except RceError as error:
            denial = ConnectionDeny(refusal_status(error, features), str(error))
            if not wants_close_code(request):
                raise denial from None
            self._denied = denial
            return None, {}
        if login.compress:  # only on request: browsers always offer it, and it helps only on slow networks
            self.perMessageCompressionAccept = _accept_deflate
        session = self._login.session
        if self.transport is None:
            self._endpoint.disconnected(session)
            raise ConnectionDeny(400, "the robot closed its connection during the login")
        return None, {"RCE-Features": ",".join(sorted(session.features))} if session.features else {}

    def onOpen(self) -> None:
        """Attach the socket to its session, or close it if the login was refused."""
        if self._denied is not None:
            self._close(REFUSED + self._denied.code, str(self._denied.reason))
            return
        assert self._login is not None
        self._pending.end()
        session = self._session = self._login.session
        self._receiver = FrameReceiver(session, self._endpoint.limits, self._endpoint.data, self.end)
        self._timer = asyncio.get_running_loop().call_later(TICK, self._tick)
        self.transport.set_write_buffer_limits(high=HIGH_WATER)
        tune(self.transport)
        previous = session.socket
        if previous is not None:
            previous.end("the robot has a newer connection")
        session.attach(self, self._login.token, self._login.resumed, self._endpoint.grace)
        self._endpoint.connected(session)

    def onClose(self, wasClean: bool, code: int | None, reason: str | None) -> None:
        """Detach the socket from its session; a normal closure ends the session of a client with features."""
        if self._timer is not None:
            self._timer.cancel()
        session = self._session
        if session is None and self._login is not None:
            session = self._login.session  # logged in, but the handshake was not completed
            if session.socket is None:
                self._endpoint.disconnected(session)
        elif session is not None and session.detach(self):
            if wasClean and code == NORMAL and session.features:
                self._endpoint.finished(session)  # clients of the original protocol always have the grace time
                return
            log.info("robot {robot} lost its socket: {reason}", robot=session.name, reason=self._reason or reason)
            self._endpoint.disconnected(session)

    # --- from the robot -----------------------------------------------------------------------------------------------

    def data_received(self, data: bytes) -> None:
        """Pass data directly to Autobahn's parser, without the queue and the future of its asyncio adapter."""
        self._data_received = True
        if self.state == self.STATE_CONNECTING and len(self.data) + len(data) > MAX_REQUEST:
            self.dropConnection(abort=True)
            return
        try:
            if self.state == self.STATE_CONNECTING:
                self._dataReceived(data)
                return
            if data:  # a view, because the parser slices it for every frame
                self.data = memoryview(b"".join((self.data, data)) if self.data else data)  # type: ignore[assignment]
            self.consumeData()
        except Exception:  # noqa: BLE001  # a defect closes this socket only, as in Autobahn's adapter
            log.failure("defect while reading from {peer}", peer=self.peer)
            self.dropConnection(abort=True)

    def onMessageFrameData(self, payload: bytes) -> None:
        """Join small fragments of a message as they come.

        Autobahn keeps every fragment as an object until the message ends, and a client may send millions of empty ones.
        """
        if self.failedByMe or not payload:
            return
        pieces: list[Any] = self.message_data
        if len(payload) >= CHUNK or not pieces or len(pieces[-1]) >= CHUNK:
            pieces.append(payload)
        elif isinstance(pieces[-1], bytearray):
            pieces[-1] += payload
        else:
            pieces[-1] = bytearray(pieces[-1]) + payload

    def onPing(self, payload: bytes) -> None:
        """Answer a ping; while the write buffer is full, only the last one (RFC 6455, section 5.5.3)."""
        if self._full:
            self._pending_pong = payload
        else:
            super().onPing(payload)

    def onMessage(self, payload: bytes, isBinary: bool) -> None:
        """Handle a complete message."""
        if self._session is None or self._reason:
            return
        if isBinary:
            self._receiver.binary(payload)
        else:
            self._receiver.text(payload)

    def _tick(self) -> None:
        self._timer = asyncio.get_running_loop().call_later(TICK, self._tick)
        if self._session is not None:
            self._receiver.sweep()
        if self.state == self.STATE_OPEN:
            self._check_liveness()

    def _check_liveness(self) -> None:
        """Ping a silent robot, and drop its connection if it stays silent.

        Autobahn's own pings count complete frames only, so they would drop a robot that is sending or receiving a large
        frame over a slow network.
        """
        unsent = self.transport.get_write_buffer_size()
        not_reading = not unsent and self._paused_until is not None
        alive = self._data_received or not_reading or unsent < self._unsent
        self._silent_ticks = 0 if alive else self._silent_ticks + 1
        self._data_received, self._unsent = False, unsent
        if self._silent_ticks == 1:
            self.sendPing()
        elif self._silent_ticks:
            self._reason = f"nothing was received for {2 * TICK:g} s"
            self.dropConnection(abort=True)

    # --- Socket -------------------------------------------------------------------------------------------------------

    def write(self, piece: Piece) -> bool:
        """Send the messages of a piece; return True if there is room for more."""
        for frame in piece:
            if self.state != self.STATE_OPEN:
                return False
            if isinstance(frame, BinaryFrame):
                self._send_large(frame, BINARY)
            elif len(frame) > CHUNK:
                self._send_large(BinaryFrame(b"", memoryview(frame)), TEXT)
            else:
                self.sendMessage(bytes(frame))
        return not self._full

    def _send_large(self, frame: BinaryFrame, kind: bytes) -> None:
        """Send one final, unmasked frame (RFC 6455, section 5.2); `sendMessage` would copy it twice."""
        if self._perMessageCompress is not None:
            self.sendMessage(frame.join(), kind == BINARY)
            return
        size = len(frame.head) + len(frame.data)
        if size < 126:
            length = bytes([size])
        elif size < 1 << 16:
            length = b"\x7e" + size.to_bytes(2)
        else:
            length = b"\x7f" + size.to_bytes(8)
        self.transport.writelines((kind + length + frame.head, frame.data))

    def pause_reading(self, until: asyncio.Future[None]) -> None:
        """Stop reading from the robot until the future is done."""
        transport = self.transport
        if self._paused_until is None and transport is not None and not transport.is_closing():
            self._paused_until = until
            transport.pause_reading()
            until.add_done_callback(self._continue_reading)

    def _continue_reading(self, _: asyncio.Future[None]) -> None:
        self._paused_until = None
        transport = self.transport
        if transport is not None and not transport.is_closing():
            transport.resume_reading()
            self.data_received(b"")

    def consumeData(self) -> None:
        """Process received frames for one slice of time, then let other robots have their turn."""
        if self.state == self.STATE_CONNECTING:
            super().consumeData()
            return
        loop = asyncio.get_running_loop()
        end = time.monotonic() + SLICE
        while self._paused_until is None and self.state != self.STATE_CLOSED and self.processData():
            if time.monotonic() > end:
                turn = loop.create_future()
                loop.call_soon(turn.set_result, None)
                self.pause_reading(turn)

    def end(self, reason: str) -> None:
        """Close the socket with this reason."""
        self._reason = reason
        if self.state == self.STATE_OPEN:
            self._close(1008, reason)

    def _close(self, code: int, reason: str) -> None:
        """Send a close frame; Autobahn's `sendClose` accepts codes of applications only."""
        self.sendCloseFrame(code, reason.encode()[:120].decode(errors="ignore").encode(), isReply=False)

    def sendCloseFrame(self, *args: Any, **more: Any) -> None:
        """Keep messages for the robot's next socket once either side begins to close this one."""
        if self._session is not None and self._session.socket is self:
            self._session.outbox.pause()
        super().sendCloseFrame(*args, **more)

    def sendData(self, data: bytes, sync: bool = False, chopsize: int | None = None) -> None:
        """Send bytes unless the connection is gone: Autobahn answers handshakes even then."""
        if self.transport is not None:
            super().sendData(data, sync, chopsize)

    def pause_writing(self) -> None:
        """Keep messages in the outbox while the transport is full."""
        self._full = True
        if self._session is not None and self._session.socket is self:
            self._session.outbox.pause()

    def resume_writing(self) -> None:
        """Answer a pending ping and let messages leave the outbox again."""
        self._full = False
        if self._pending_pong is not None:
            payload, self._pending_pong = self._pending_pong, None
            self.onPing(payload)
        if self._session is not None and self._session.socket is self and self.state == self.STATE_OPEN:
            self._session.outbox.resume()


class _Factory(WebSocketServerFactory):
    def __init__(self, endpoint: RobotEndpoint, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(server="RCE", loop=loop)
        self._endpoint = endpoint

    def make(self, pending: PendingLogin) -> RobotSocket:
        """Return the protocol of a new connection."""
        socket = RobotSocket(self._endpoint, pending)
        socket.factory = self  # type: ignore[attr-defined]  # as the base class does
        return socket


async def listen(endpoint: RobotEndpoint, host: str, port: int, tls: Any) -> Listener:
    """Serve robots at `host:port`.

    Args:
        endpoint: The endpoint, which has the robots' sessions.
        host: Local address.
        port: Port; 0 for any free one.
        tls: SSLContext for wss; None for ws.

    Raises:
        Unavailable: The port cannot be bound.
    """
    loop = asyncio.get_running_loop()
    txaio.config.loop = loop  # type: ignore[attr-defined]  # Autobahn's ping and handshake timers run on it
    factory = _Factory(endpoint, loop)
    factory.setProtocolOptions(
        maxMessagePayloadSize=endpoint.limits.message,
        maxFramePayloadSize=endpoint.limits.message,
        allowNullOrigin=True,  # the origin of a page from a file; setProtocolOptions would reset it
        openHandshakeTimeout=HANDSHAKE_TIMEOUT,
        closeHandshakeTimeout=1,  # a connection that was cut off is gone by then
        failByDrop=False,  # tell the robot which rule it broke
        utf8validateIncoming=False,  # the decoders validate it, so the robot gets an error and keeps its socket
    )
    return Listener(bind(host, port), factory.make, tls)
