"""The WebSocket server for robots: their sockets open, live, and close; turns to read and to write.

Autobahn is known in this file only.
"""

from __future__ import annotations

import asyncio
import time
from typing import Any

import txaio
from twisted.logger import Logger
from websockets.speedups import apply_mask

from endpoints.robot.door import Admitted, Door
from endpoints.robot.handshake import hears_by_closing, read_request, refusal_status
from endpoints.robot.intake import Intake
from endpoints.robot.session import Piece, Session
from rce.blobs import BinaryFrame, Buffer
from rce.errors import RceError, no_port
from rce.sockets import tune

txaio.use_asyncio()  # before Autobahn is imported: it asks once which of the two it runs on
from autobahn.asyncio.websocket import WebSocketServerFactory, WebSocketServerProtocol  # noqa: E402
from autobahn.websocket import protocol  # noqa: E402
from autobahn.websocket.compress import PerMessageDeflateOffer, PerMessageDeflateOfferAccept  # noqa: E402
from autobahn.websocket.types import ConnectionDeny, ConnectionRequest  # noqa: E402

HIGH_WATER = 256 * 1024  # bytes in the transport at which the outbox keeps what follows, where it can be overtaken
MAX_REQUEST = 64 * 1024  # bytes before a robot is let in
PIECE = 64 * 1024  # bytes: smaller pieces of a message are put together as they come
SLICE = 0.0005  # seconds for which one robot's frames may be worked on at a stretch
TICK = 10.0  # seconds: a robot from which nothing came for so long is pinged, and given up after as long again
NORMAL = 1000  # the close code of a peer that has done all it wanted
REFUSED = 4000  # plus the HTTP status: the close code of a robot that is refused and asked to hear it so

log = Logger()


def _accept_deflate(offers: list[Any]) -> PerMessageDeflateOfferAccept | None:
    offer = next((offer for offer in offers if isinstance(offer, PerMessageDeflateOffer)), None)
    return PerMessageDeflateOfferAccept(offer) if offer is not None else None


class _Masker:
    """Takes the mask off a frame (RFC 6455, section 5.3) in one pass; Autobahn's own masker makes four."""

    def __init__(self, mask: Buffer, _length: int) -> None:
        self._mask = bytes(mask)
        self._done = 0

    def pointer(self) -> int:
        return self._done

    def process(self, data: Buffer) -> bytes:
        turn = self._done % 4
        self._done += len(data)
        return apply_mask(data, self._mask[turn:] + self._mask[:turn])


protocol.create_xor_masker = _Masker  # type: ignore[attr-defined, assignment]  # its parser asks there


class RobotSocket(WebSocketServerProtocol):
    """One robot's WebSocket."""

    def __init__(self, door: Door) -> None:
        super().__init__()
        self._door = door
        self._admitted: Admitted | None = None
        self._session: Session | None = None
        self._denied: ConnectionDeny | None = None  # what a robot hears by closing
        self._full = False
        self._reason = ""
        self._timer: asyncio.TimerHandle | None = None
        self._hold: asyncio.Future[None] | None = None  # until when nothing is taken from the robot
        self._heard = False  # since the last tick
        self._silent = 0  # ticks
        self._left = 0  # bytes that waited to leave at the last tick
        self._pinged: bytes | None = None  # by what, while there is no room for the answer

    # --- handshake ----------------------------------------------------------------------------------------------------

    async def onConnect(  # type: ignore[override]  # a coroutine may stand for the value
        self, request: ConnectionRequest
    ) -> tuple[None, dict[str, str]]:
        features: frozenset[str] = frozenset()
        try:
            greeting = read_request(request)
            features = greeting.features
            self._admitted = await self._door.login(greeting)
        except RceError as error:
            denial = ConnectionDeny(refusal_status(error, features), str(error))
            if not hears_by_closing(request):
                raise denial from None
            self._denied = denial
            return None, {}
        if greeting.compress:  # browsers offer it always; it costs more than it gains unless the line is slow
            self.perMessageCompressionAccept = _accept_deflate
        session = self._admitted.session
        if self.transport is None:
            self._door.disconnected(session)
            raise ConnectionDeny(400, "it hung up while it was looked up")
        return None, {"RCE-Features": ",".join(sorted(session.features))} if session.features else {}

    def onOpen(self) -> None:
        if self._denied is not None:
            self._close(REFUSED + self._denied.code, str(self._denied.reason))
            return
        assert self._admitted is not None
        session = self._session = self._admitted.session
        self._intake = Intake(self._door, session, self.end)
        self._timer = asyncio.get_running_loop().call_later(TICK, self._tick)
        self.transport.set_write_buffer_limits(high=HIGH_WATER)
        tune(self.transport)
        previous = session.socket
        if previous is not None:
            previous.end("the robot has another connection now")
        session.attach(self, self._admitted.token, self._admitted.resumed, self._door.grace)
        self._door.connected(session)

    def onClose(self, wasClean: bool, code: int | None, reason: str | None) -> None:
        if self._timer is not None:
            self._timer.cancel()
        session = self._session
        if session is None and self._admitted is not None:
            session = self._admitted.session  # admitted, but never open
            if session.socket is None:
                self._door.disconnected(session)
        elif session is not None and session.detach(self):
            if wasClean and code == NORMAL and session.features:
                self._door.finished(session)  # clients of the original are used to the grace time in any case
                return
            log.info("robot {robot} lost its socket: {reason}", robot=session.name, reason=self._reason or reason)
            self._door.disconnected(session)

    # --- from the robot -----------------------------------------------------------------------------------------------

    def data_received(self, data: bytes) -> None:
        """Straight to Autobahn's parser, past the queue and future that its asyncio adapter puts in between."""
        self._heard = True
        if self.state == self.STATE_CONNECTING and len(self.data) + len(data) > MAX_REQUEST:
            self.dropConnection(abort=True)
            return
        try:
            if self.state == self.STATE_CONNECTING:
                self._dataReceived(data)
                return
            if data:  # a view, because the parser cuts frames out of it again and again
                self.data = memoryview(b"".join((self.data, data)) if self.data else data)  # type: ignore[assignment]
            self.consumeData()
        except Exception:  # noqa: BLE001  # as its adapter does: a defect closes this socket and no other
            log.failure("defect while reading from {peer}", peer=self.peer)
            self.dropConnection(abort=True)

    def onMessageFrameData(self, payload: bytes) -> None:
        """Autobahn keeps each piece by itself until the message ends: of one byte, or none, there may be millions."""
        if self.failedByMe or not payload:
            return
        pieces: list[Any] = self.message_data
        if len(payload) >= PIECE or not pieces or len(pieces[-1]) >= PIECE:
            pieces.append(payload)
        elif isinstance(pieces[-1], bytearray):
            pieces[-1] += payload
        else:
            pieces[-1] = bytearray(pieces[-1]) + payload

    def onPing(self, payload: bytes) -> None:
        """Of several pings that wait for an answer the last has it (RFC 6455, section 5.5.3)."""
        if self._full:
            self._pinged = payload
        else:
            super().onPing(payload)

    def onMessage(self, payload: bytes, isBinary: bool) -> None:
        if self._session is None or self._reason:
            return
        if isBinary:
            self._intake.binary(payload)
        else:
            self._intake.text(payload)

    def _tick(self) -> None:
        self._timer = asyncio.get_running_loop().call_later(TICK, self._tick)
        if self._session is not None:
            self._intake.sweep()
        if self.state == self.STATE_OPEN:
            self._see_whether_it_lives()

    def _see_whether_it_lives(self) -> None:
        """Autobahn's pings know only whole frames: they end robots that send or take a large one over a slow line."""
        left = self.transport.get_write_buffer_size()
        held = not left and self._hold is not None  # we do not listen
        self._silent = 0 if self._heard or held or left < self._left else self._silent + 1
        self._heard, self._left = False, left
        if self._silent == 1:
            self.sendPing()
        elif self._silent:
            self._reason = f"no sign of life for {2 * TICK:g} s"
            self.dropConnection(abort=True)

    # --- Socket -------------------------------------------------------------------------------------------------------

    def write(self, piece: Piece) -> bool:
        for frame in piece:
            if self.state != self.STATE_OPEN:
                return False
            if isinstance(frame, BinaryFrame):
                self._send_binary(frame)
            else:
                self.sendMessage(frame)
        return not self._full

    def _send_binary(self, frame: BinaryFrame) -> None:
        """As `sendMessage`, which would copy the frame twice (RFC 6455, section 5.2: one final, unmasked frame)."""
        if self._perMessageCompress is not None:
            self.sendMessage(frame.join(), True)
            return
        size = len(frame.head) + len(frame.data)
        if size < 126:
            length = bytes([size])
        elif size < 1 << 16:
            length = b"\x7e" + size.to_bytes(2)
        else:
            length = b"\x7f" + size.to_bytes(8)
        self.transport.writelines((b"\x82" + length + frame.head, frame.data))

    def hold(self, until: asyncio.Future[None]) -> None:
        transport = self.transport
        if self._hold is None and transport is not None and not transport.is_closing():
            self._hold = until
            transport.pause_reading()
            until.add_done_callback(self._go_on)

    def _go_on(self, _: asyncio.Future[None]) -> None:
        self._hold = None
        transport = self.transport
        if transport is not None and not transport.is_closing():
            transport.resume_reading()
            self.data_received(b"")

    def consumeData(self) -> None:
        """Work off what has come, but no longer than a slice of time: there are other robots."""
        if self.state == self.STATE_CONNECTING:
            super().consumeData()
            return
        loop = asyncio.get_running_loop()
        end = time.monotonic() + SLICE
        while self._hold is None and self.state != self.STATE_CLOSED and self.processData():
            if time.monotonic() > end:
                turn = loop.create_future()
                loop.call_soon(turn.set_result, None)
                self.hold(turn)

    def end(self, reason: str) -> None:
        self._reason = reason
        if self.state == self.STATE_OPEN:
            self._close(1008, reason)

    def _close(self, code: int, reason: str) -> None:
        """Not `sendClose`: that one takes the codes of applications only."""
        self.sendCloseFrame(code, reason.encode()[:120].decode(errors="ignore").encode(), isReply=False)

    def sendCloseFrame(self, *args: Any, **more: Any) -> None:
        """Whoever closes: what is for the robot waits for its next socket from here on."""
        if self._session is not None and self._session.socket is self:
            self._session.outbox.pause()
        super().sendCloseFrame(*args, **more)

    def sendData(self, data: bytes, sync: bool = False, chopsize: int | None = None) -> None:
        """Autobahn answers handshakes of peers that are gone."""
        if self.transport is not None:
            super().sendData(data, sync, chopsize)

    def pause_writing(self) -> None:
        self._full = True
        if self._session is not None and self._session.socket is self:
            self._session.outbox.pause()

    def resume_writing(self) -> None:
        self._full = False
        if self._pinged is not None:
            pinged, self._pinged = self._pinged, None
            self.onPing(pinged)
        if self._session is not None and self._session.socket is self and self.state == self.STATE_OPEN:
            self._session.outbox.resume()


class _Factory(WebSocketServerFactory):
    def __init__(self, door: Door, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(server="RCE", loop=loop)
        self._door = door

    def __call__(self) -> RobotSocket:
        made = RobotSocket(self._door)
        made.factory = self  # type: ignore[attr-defined]  # as its base class does
        return made


async def listen(door: Door, host: str, port: int, tls: Any) -> asyncio.Server:
    """Take robots at `host:port`; `tls` is an SSLContext, or None for plain ws. Unavailable."""
    loop = asyncio.get_running_loop()
    txaio.config.loop = loop  # type: ignore[attr-defined]  # Autobahn's ping and handshake timers run on it
    factory = _Factory(door, loop)
    factory.setProtocolOptions(
        maxMessagePayloadSize=door.limits.message,
        maxFramePayloadSize=door.limits.message,
        allowNullOrigin=True,  # of a page from a file; unless said so, setting options forbids it
        openHandshakeTimeout=30,
        closeHandshakeTimeout=1,  # one that is cut off is gone by then
        failByDrop=False,  # a robot that breaks a rule is told which
        utf8validateIncoming=False,  # the decoders check it: the robot gets an error and keeps its socket
    )
    try:
        return await loop.create_server(factory, host, port, ssl=tls)
    except OSError as error:
        raise no_port(host, port, error) from None
