"""WebSocket of one client: a robot, or a client of a gateway."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from typing import Any

from autobahn.asyncio.websocket import WebSocketServerProtocol
from autobahn.websocket.compress import PerMessageDeflateOffer, PerMessageDeflateOfferAccept
from autobahn.websocket.types import ConnectionDeny, ConnectionRequest
from twisted.logger import Logger

from endpoints.data.turns import SLICE, Turns
from endpoints.robot.client import Choose, Client
from endpoints.robot.framing import first_message, framed_all
from endpoints.robot.handshake import refusal_status, wants_close_code
from endpoints.robot.session import Piece
from rce.errors import RceError
from rce.net.flight import Flight, flight_of
from rce.net.pending_logins import PendingLogin
from rce.net.sockets import tune
from rce.net.writer import Passes, Writer
from rce.protocol.blobs import BinaryFrame, Buffer

HIGH_WATER = 256 * 1024  # bytes; while the transport holds more, messages wait in the outbox, where they take turns
MAX_REQUEST = 64 * 1024  # bytes of the opening HTTP request
CHUNK = 64 * 1024  # bytes; smaller fragments of a message are joined as they come
TICK = 10.0  # seconds; a robot that is silent for one tick is pinged, after two its socket is closed
NORMAL = 1000  # close code of a normal closure (RFC 6455, section 7.4.1)
TURN = "turn"  # of the user, for which reading waits
REFUSED = 4000  # plus the HTTP status: close code of a refusal after the handshake

log = Logger()


def _accept_deflate(offers: list[Any]) -> PerMessageDeflateOfferAccept | None:
    offer = next((offer for offer in offers if isinstance(offer, PerMessageDeflateOffer)), None)
    return PerMessageDeflateOfferAccept(offer) if offer is not None else None


class ClientSocket(WebSocketServerProtocol):
    """WebSocket of one client: a robot, or a client of a gateway."""

    send_queue: Any = ()  # in place of Autobahn's, once the socket is open: nothing is sent in chops

    def __init__(self, turns: Turns, passes: Passes, choose: Choose, pending: PendingLogin) -> None:
        """Create the socket of a new connection.

        Args:
            turns: Turns of users at the event loop.
            passes: Passes of the event loop, in which small messages are written together.
            choose: Returns the client for the path of the request.
            pending: Counts the connection until it is logged in.
        """
        super().__init__()
        self._turns = turns
        self._passes = passes
        self._choose = choose
        self._pending = pending
        self._request_waits = False  # for its turn
        self._logging_in = False
        self._opened = False
        self._client: Client | None = None
        self._user = ""
        self._denied: ConnectionDeny | None = None  # refusal to be sent as a close code
        self._full = False
        self._reason = ""
        self._timer: asyncio.TimerHandle | None = None
        self._writer: Writer | None = None  # while the socket is open
        self._flight = Flight(lambda: None)  # holds nothing back
        self._look: asyncio.TimerHandle | None = None  # the next look whether the line has room
        self._pauses: dict[object, None] = {}  # what reading waits for: futures, and TURN
        self._turn_waits = False  # received data waits for a turn of the user
        self._data_received = False  # since the last tick
        self._silent_ticks = 0
        self._unsent = 0  # bytes in the write buffer at the last tick
        self._pending_pong: bytes | None = None  # payload of a ping that came while the write buffer was full

    def connection_lost(self, exc: Exception | None) -> None:
        """Count the connection no longer, and break the reference cycles of this socket: it is freed at once."""
        self._pending.end()
        super().connection_lost(exc)
        self._client = None
        del self.is_closed  # a future of Autobahn

    def _consume(self) -> None:
        """Remove the queue of Autobahn's asyncio adapter, which `data_received` does not use."""
        del self.receive_queue

    # --- handshake ----------------------------------------------------------------------------------------------------

    async def onConnect(  # type: ignore[override]  # Autobahn accepts a coroutine
        self, request: ConnectionRequest
    ) -> tuple[str | None, dict[str, str]]:
        """Log the client in, or refuse the handshake."""
        self._logging_in = True
        client = self._choose(str(request.path))
        try:
            accepted = await client.login(request)
        except RceError as error:
            denial = ConnectionDeny(refusal_status(error, client.features), str(error))
            if not wants_close_code(request) or self._gone:
                raise denial from None
            self._denied = denial
            return None, {}
        self._client = client
        if accepted.compress:  # only on request: browsers always offer it, and it helps only on slow networks
            self.perMessageCompressionAccept = _accept_deflate
        if self._gone:
            client.abandoned()
            raise ConnectionDeny(400, "the client closed its connection during the login")
        return accepted.subprotocol or None, accepted.headers

    @property
    def _gone(self) -> bool:
        """True if the connection was lost or dropped during the login; Autobahn would open it again."""
        return self.transport is None or self.state == self.STATE_CLOSED

    def succeedHandshake(self, res: Any) -> None:
        """Open the connection, unless it was lost just after the login."""
        if not self._gone:
            super().succeedHandshake(res)

    def onOpen(self) -> None:
        """Hand the socket to its client, or close it if the login was refused."""
        if self._denied is not None:
            self._close(REFUSED + self._denied.code, str(self._denied.reason))
            return
        assert self._client is not None
        self._forget_handshake()
        self._pending.end()
        self._opened = True
        self._user = self._client.user
        self._timer = asyncio.get_running_loop().call_later(TICK, self._tick)
        self.transport.set_write_buffer_limits(high=HIGH_WATER)
        tune(self.transport)
        self._writer = Writer(self.transport, self._passes)
        self._flight = flight_of(self.transport.get_extra_info("socket"))
        self._client.opened(self)

    def _forget_handshake(self) -> None:
        """Free what an open socket does not need: two kilobytes."""
        del self.send_queue
        for name in [name for name in vars(self) if name.startswith("http_")]:
            delattr(self, name)

    def onClose(self, wasClean: bool, code: int | None, reason: str | None) -> None:
        """Tell the client that its socket is closed."""
        for timer in (self._timer, self._look):
            if timer is not None:
                timer.cancel()
        if self._client is None:
            return
        if self._opened:
            self._client.closed(wasClean and code == NORMAL, self._reason or reason or "")
        else:  # logged in, but the handshake was not completed
            self._client.abandoned()

    # --- from the robot -----------------------------------------------------------------------------------------------

    def data_received(self, data: bytes) -> None:
        """Pass data directly to Autobahn's parser, without the queue and the future of its asyncio adapter."""
        self._data_received = True
        if self.state == self.STATE_CONNECTING:
            self._receive_request(data)
            return
        if data:  # a view, because the parser slices it for every frame
            self.data = memoryview(b"".join((self.data, data)) if self.data else data)  # type: ignore[assignment]
            if self._turn_waits:  # a pause costs system calls, so the first data that wait do not cause one
                self._pause(TURN)
            elif self._turns.busy(self._user):
                self._wait_for_turn()
        self.consumeData()

    def _receive_request(self, data: bytes) -> None:
        """Receive a part of the opening request, or of the first messages, which wait for the end of the login.

        Many clients may come at once, so those at one address take turns.
        """
        if len(self.data) + len(data) > MAX_REQUEST:
            self.dropConnection(abort=True)
            return
        self.data += data
        if not self._logging_in and not self._request_waits:
            self._request_waits = True
            self._turns.wait(f"@{self._pending.place}", self._read_request)

    def _read_request(self) -> None:
        self._request_waits = False
        if not self._gone:
            self.consumeData()

    def processData(self) -> bool:
        """Process the next frame, or the received part of it; return True if there may be more."""
        if self.current_frame is None and not self.inside_message and self.state == self.STATE_OPEN:
            message = first_message(self.data, self.maxMessagePayloadSize)
            if message is not None:
                self.data = self.data[message.size :]
                self._message(message.is_binary, (message.payload,))
                return len(self.data) > 0
        more: bool = super().processData()
        return more

    # Autobahn's adapter for asyncio asks after each of its callbacks whether the result is a coroutine.
    _onMessageBegin = WebSocketServerProtocol.onMessageBegin
    _onMessageFrameBegin = WebSocketServerProtocol.onMessageFrameBegin

    def _onMessageFrameData(self, payload: bytes) -> None:
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

    def _onMessageFrameEnd(self) -> None:
        """Do nothing: the data of the frame is among that of its message."""

    def onPing(self, payload: bytes) -> None:
        """Answer a ping; while the write buffer is full, only the last one (RFC 6455, section 5.5.3)."""
        if self._full:
            self._pending_pong = payload
        else:
            super().onPing(payload)

    def _onMessageEnd(self) -> None:
        """Handle a message that came in one or more fragments; Autobahn would join them."""
        fragments, self.message_data = self.message_data, []
        if not self.failedByMe:
            self._message(self.message_is_binary, fragments or (b"",))

    def _message(self, is_binary: bool, fragments: Sequence[bytes]) -> None:
        if self._client is None or not self._opened or self._reason:
            return
        if is_binary:
            self._client.binary(*fragments)
        else:
            self._client.text(fragments[0] if len(fragments) == 1 else b"".join(fragments))

    def _tick(self) -> None:
        self._timer = asyncio.get_running_loop().call_later(TICK, self._tick)
        if self._client is not None:
            self._client.sweep()
        if self.state == self.STATE_OPEN:
            self._check_liveness()

    def _check_liveness(self) -> None:
        """Ping a silent robot, and drop its connection if it stays silent.

        Autobahn's own pings count complete frames only, so they would drop a robot that is sending or receiving a large
        frame over a slow network.
        """
        unsent = self.transport.get_write_buffer_size()
        not_reading = not unsent and bool(self._pauses)
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
        if self.state != self.STATE_OPEN or self._writer is None:
            return False
        buffers, written = framed_all(piece), True
        if self._perMessageCompress is not None:
            for frame in piece:
                binary = isinstance(frame, BinaryFrame)
                self.sendMessage(bytes(frame) if isinstance(frame, Buffer) else frame.join(), binary)
        else:
            written = self._writer.write(buffers)
        has_room = self._has_room(sum(map(len, buffers)))
        return not self._full and (not written or has_room)

    @property
    def part(self) -> int:
        """Bytes of the next part of a large message."""
        return self._flight.part

    def _has_room(self, written: int = 0) -> bool:
        """Return whether the line has room after so many more bytes; look again later if it has none."""
        seconds = self._flight.wait(written)
        if seconds and self._look is None:
            self._look = asyncio.get_running_loop().call_later(seconds, self._look_again)
        return not seconds

    def _look_again(self) -> None:
        self._look = None
        self._proceed()

    def _proceed(self) -> None:
        """Let messages leave the outbox if the line has room."""
        if self.state == self.STATE_OPEN and not self._full and self._client is not None and self._has_room():
            self._client.proceed()

    def pause_reading(self, until: asyncio.Future[None]) -> None:
        """Stop reading from the client until this future, and all others that were given, are done."""
        if self._pause(until):
            until.add_done_callback(self._continue_reading)

    def _pause(self, until: object) -> bool:
        """Stop reading until this is done; return False if reading waits for it already, or has ended."""
        transport = self.transport
        if until in self._pauses or transport is None or transport.is_closing():
            return False
        if not self._pauses:
            transport.pause_reading()
        self._pauses[until] = None
        return True

    def _continue_reading(self, done: object) -> None:
        self._pauses.pop(done, None)
        if self._pauses:
            return
        transport = self.transport
        if transport is not None and not transport.is_closing():
            transport.resume_reading()
            self.data_received(b"")

    def consumeData(self) -> None:
        """Process received frames for one slice of time, then let other users have their turn.

        A defect closes this socket only, as in Autobahn's adapter.
        """
        try:
            if self.state == self.STATE_CONNECTING:
                super().consumeData()
                return
            end = time.monotonic() + SLICE
            while not self._turn_waits and not self._pauses and self.state != self.STATE_CLOSED and self.processData():
                if time.monotonic() > end:
                    self._pause(TURN)  # what is left comes first
                    self._wait_for_turn()
        except Exception:  # noqa: BLE001  # it is logged
            log.failure("defect while reading from {peer}", peer=self.peer)
            self.dropConnection(abort=True)

    def _wait_for_turn(self) -> None:
        self._turn_waits = True
        self._turns.wait(self._user, self._take_turn)

    def _take_turn(self) -> None:
        self._turn_waits = False
        if TURN in self._pauses:
            self._continue_reading(TURN)
        else:
            self.consumeData()

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
        if self._client is not None and self._opened:
            self._client.hold()
        super().sendCloseFrame(*args, **more)

    def sendData(self, data: bytes, sync: bool = False, chopsize: int | None = None) -> None:
        """Send bytes after those that wait, unless the connection is gone: Autobahn answers handshakes even then."""
        if self._writer is not None:
            self._writer.flush()
        if self.transport is not None:
            super().sendData(data, sync, chopsize)

    def pause_writing(self) -> None:
        """Keep messages in the outbox while the transport is full."""
        self._full = True
        if self._client is not None and self._opened:
            self._client.hold()

    def resume_writing(self) -> None:
        """Answer a pending ping and let messages leave the outbox again."""
        self._full = False
        if self._pending_pong is not None:
            payload, self._pending_pong = self._pending_pong, None
            self.onPing(payload)
        if self._opened:
            self._proceed()
