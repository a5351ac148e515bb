"""WebSocket connection to a Robot endpoint.

Outgoing frames go through an outbox that takes turns between the interfaces; incoming text frames are joined with their
blobs.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncGenerator, Callable, Iterator, Mapping
from typing import NamedTuple, get_args

import msgspec

from rce.client.address import FEATURES_HEADER, Address
from rce.client.dialing import address_is_gone
from rce.client.websocket import ConnectionClosed, WebSocket
from rce.errors import InvalidRequest, RceError, TimedOut, Unavailable
from rce.net.flight import flight_of
from rce.net.outbox import Outbox, Priority
from rce.protocol.assembler import Assembled, Assembler, AssemblyResult
from rce.protocol.blobs import STAR, Buffer, binary_frames
from rce.protocol.messages import (
    FEATURES,
    DataMessage,
    Failure,
    Frame,
    FrameId,
    Session,
    Status,
    StatusData,
    decode_as,
    decode_frame,
)

SWEEP_INTERVAL = 15.0
SESSION_TIMEOUT = 10.0
FLUSH_TIMEOUT = 5.0
LOOK = 0.25  # seconds between two looks whether the line is dead

log = logging.getLogger("rce.client")


class Message(NamedTuple):
    """Data message (DM frame) with its blobs by id."""

    data: DataMessage
    blobs: Mapping[str, Buffer]


class Piece(NamedTuple):
    """One WebSocket message of an outgoing frame."""

    payload: bytes
    text: bool


Incoming = Message | Status | Failure | RceError


class Connection:
    """Open WebSocket with its session.

    Attributes:
        features: Protocol features that the server granted; empty for a server of the original.
        endpoint: URL of the Robot endpoint.
        session: Session status, the first frame of a server with features.
    """

    def __init__(self, websocket: WebSocket, features: frozenset[str], endpoint: str) -> None:
        self.features = features
        self.endpoint = endpoint
        self.session = Session(features=[])
        self._websocket = websocket
        self._assembler = Assembler(time.monotonic, parts="parts" in features)
        self._swept = time.monotonic()
        self._outbox: Outbox[Piece] = Outbox(self._next)
        self._piece = Piece(b"", False)
        self._has_piece = asyncio.Event()
        self._written = asyncio.Event()
        self._flight = flight_of(websocket.socket)
        self._expected: dict[FrameId, Callable[[RceError | None], None]] = {}

    @staticmethod
    async def open(address: Address, endpoint: str, token: str) -> Connection:
        """Open the WebSocket and, if the server grants features, wait for its session status.

        Args:
            address: Platform and credentials.
            endpoint: WebSocket URL of the Robot endpoint.
            token: Resumption token of an earlier connection, or an empty string.

        Raises:
            Unavailable: The endpoint cannot be reached or sends no session status.
            RceError: The endpoint refuses the robot; see `Address.dial`.
        """
        websocket = await address.dial(endpoint, token)
        header = websocket.header(FEATURES_HEADER)
        features = FEATURES & {name.strip() for name in (header or "").split(",")}
        connection = Connection(websocket, features, endpoint)
        if header is not None:
            try:
                connection.session = await connection._receive_session()
            except BaseException:
                await connection.close()
                raise
        return connection

    async def _receive_session(self) -> Session:
        try:
            async with asyncio.timeout(SESSION_TIMEOUT):
                first = self._decode_text(await self._websocket.receive())
        except (TimeoutError, ConnectionClosed) as error:
            raise Unavailable(f"{self.endpoint} sent no session status: {str(error) or 'no answer'}") from None
        if isinstance(first, Status) and isinstance(first.data, Session):
            return first.data
        raise Unavailable(f"{self.endpoint} grants features, but its first frame is not a session status")

    def put(
        self, source: str, pieces: Iterator[Piece], keep: int | None = None, priority: Priority = Priority.NORMAL
    ) -> int:
        """Queue the frames of one message; see `Outbox.put`."""
        return self._outbox.put(source.encode(), pieces, keep, priority=priority)

    def put_message(
        self,
        source: str,
        text: bytes,
        blobs: Mapping[str, Buffer],
        keep: int | None = None,
        priority: Priority = Priority.NORMAL,
        may_start: Callable[[], bool] = lambda: True,
    ) -> int:
        """Queue a text frame with its blobs.

        Args:
            source: Source of the message.
            text: The text frame.
            blobs: Its blobs by id.
            keep: Number of messages of the source that may wait, the newest; None for all.
            priority: Priority of the source.
            may_start: Called when the turn of the message comes; returns False to drop it.

        Returns:
            The number of older messages of the source that were dropped for it.
        """

        def pieces() -> Iterator[Piece]:
            if may_start():
                yield from self._pieces(text, blobs)

        return self.put(source, pieces(), keep, priority)

    def put_text(self, source: str, text: bytes, on_sent: Callable[[], None]) -> None:
        """Queue a text frame and call `on_sent` once it has been written."""

        def pieces() -> Iterator[Piece]:
            yield Piece(text, True)
            on_sent()

        self.put(source, pieces())

    def expect(self, frame_id: FrameId, answered: Callable[[RceError | None], None]) -> None:
        """Have `answered` called with the answer to a data message: None, or the error."""
        self._expected[frame_id] = answered

    def answer(self, frame_id: FrameId, error: RceError | None) -> bool:
        """Pass on the answer to a data message; return False if the frame was none that is expected to be answered."""
        answered = self._expected.pop(frame_id, None)
        if answered is not None:
            answered(error)
        return answered is not None

    def room(self, source: str) -> asyncio.Future[None] | None:
        """Return None if the source may send now, else a future that completes when its queue is empty."""
        return self._outbox.wait_for_room(source.encode())

    async def receive(self) -> AsyncGenerator[Incoming, None]:
        """Send the queued frames and yield what arrives, until the socket is closed.

        Yielded errors are malformed or incomplete messages of the server; they do not end the connection.
        """
        sender, watcher = asyncio.create_task(self._send()), asyncio.create_task(self._watch())
        try:
            while True:
                payload = await self._websocket.receive()
                try:
                    incoming = self._decode(payload)
                except RceError as error:
                    incoming = error
                if incoming is not None:
                    yield incoming
                for timed_out in self._sweep():
                    yield timed_out
        except ConnectionClosed:
            return
        finally:
            sender.cancel()
            watcher.cancel()
            await asyncio.wait([sender, watcher])
            self._outbox.clear()  # last: no sender may wait for room afterwards
            self._written.set()

    async def flush(self) -> None:
        """Wait until the queued frames have been written, for `FLUSH_TIMEOUT` seconds at most."""
        try:
            async with asyncio.timeout(FLUSH_TIMEOUT):
                while not self._outbox.empty:
                    self._written.clear()
                    await self._written.wait()
        except TimeoutError:
            log.warning("%s did not accept the queued frames within %g s; they are lost", self.endpoint, FLUSH_TIMEOUT)

    async def close(self) -> None:
        """Close with code 1000, which ends the session."""
        await self._websocket.close()

    @property
    def reason(self) -> str:
        """Reason of the close frame, or the close code if there is none."""
        return self._websocket.reason

    def _pieces(self, text: bytes, blobs: Mapping[str, Buffer]) -> Iterator[Piece]:
        yield Piece(text, True)
        for frame in binary_frames(blobs, "parts" in self.features, lambda: self._flight.part):
            yield Piece(frame.join(), False)

    def _next(self, piece: Piece) -> bool:
        self._piece = piece
        self._has_piece.set()
        return False  # one at a time: the outbox chooses the next one when this one has been written

    async def _send(self) -> None:
        while True:
            await self._has_piece.wait()
            self._has_piece.clear()
            try:
                await self._websocket.send(self._piece.payload, self._piece.text)
                written = len(self._piece.payload)
                while seconds := self._flight.wait(written):  # the kernel does not tell when there is room
                    written = 0
                    await asyncio.sleep(seconds)
                self._outbox.resume()
            except ConnectionClosed:
                return
            except Exception:
                self._websocket.abort()  # without its sender the connection is of no use: reconnect
                raise
            self._written.set()

    async def _watch(self) -> None:
        """Drop the connection when its line is dead, so that the session reconnects."""
        while True:
            await asyncio.sleep(LOOK)
            if self._flight.stalled() or address_is_gone(self._websocket.socket):
                log.info("the line to %s is dead: connecting again", self.endpoint)
                self._websocket.abort()
                return

    def _decode(self, payload: bytes) -> Incoming | None:
        """Distinguish text from binary frames by the first byte: a blob id begins with a hex digit, JSON does not."""
        if payload[:1] in (b"{", b" ", b"\t", b"\n", b"\r"):
            return self._decode_text(payload)
        return self._message_of(self._assembler.add_blob(payload))

    def _decode_text(self, payload: bytes) -> Incoming | None:
        frame = decode_frame(payload)
        if frame.type == "DM":
            # A key that refers to a blob ends in a star; without one the search for references can be skipped.
            return self._message_of(
                self._assembler.add_frame(frame) if STAR in payload else AssemblyResult(Assembled(frame, {}))
            )
        if frame.type == "ST":
            return _status(frame)
        if frame.type == "ER":
            return decode_as(Failure, payload, "ER")
        raise InvalidRequest(f"the server sent a frame of unknown type {frame.type!r}")

    def _message_of(self, outcome: AssemblyResult) -> Incoming | None:
        if outcome.dropped:
            return outcome.dropped[0].error
        if outcome.complete is None:
            return None
        frame, blobs = outcome.complete
        return Message(decode_as(DataMessage, frame.data, "DM"), blobs)

    def _sweep(self) -> list[RceError]:
        now = time.monotonic()
        if now - self._swept < SWEEP_INTERVAL:
            return []
        self._swept = now
        return [
            TimedOut(f"the blobs of a message from the server did not arrive: {each.error}")
            for each in self._assembler.sweep()
        ]


def _status(frame: Frame) -> Status | None:
    """Decode an ST frame; returns None for an unknown topic, since later servers may have more."""
    kind = _topics.get(decode_as(_Topic, frame.data, "ST").topic)
    return Status(decode_as(kind, frame.data, "ST"), frame.id) if kind is not None else None


class _Topic(msgspec.Struct):
    topic: str


_topics: dict[str, type[StatusData]] = {str(kind.__struct_config__.tag): kind for kind in get_args(StatusData)}
