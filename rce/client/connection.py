"""One WebSocket to a Robot endpoint: frames out in turns between the interfaces, frames in with their blobs."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncGenerator, Callable, Iterator, Mapping
from typing import NamedTuple, get_args

import msgspec
from websockets.asyncio.client import ClientConnection
from websockets.exceptions import ConnectionClosed

from rce.assembler import Assembled, Assembler, Outcome
from rce.blobs import Buffer, binary_frames
from rce.client.address import FEATURES_HEADER, Address
from rce.errors import InvalidRequest, RceError, TimedOut, Unavailable
from rce.messages import (
    FEATURES,
    DataMessage,
    Failure,
    Frame,
    Session,
    Status,
    StatusData,
    decode_as,
    decode_frame,
)
from rce.outbox import Outbox

SWEEP = 15.0
SESSION_TIMEOUT = 10.0
FLUSH_TIMEOUT = 5.0

log = logging.getLogger("rce.client")


class Message(NamedTuple):
    """A DM with its blobs."""

    data: DataMessage
    blobs: Mapping[str, Buffer]


class Piece(NamedTuple):
    """One WebSocket message."""

    payload: bytes
    text: bool


Incoming = Message | Status | Failure | RceError


class Connection:
    """An open WebSocket. `features` are those that the server granted: none means the original server."""

    def __init__(self, socket: ClientConnection, features: frozenset[str], endpoint: str) -> None:
        self.features = features
        self.endpoint = endpoint
        self.session = Session(features=[])
        self._socket = socket
        self._assembler = Assembler(time.monotonic, parts="parts" in features)
        self._swept = time.monotonic()
        self._outbox: Outbox[Piece] = Outbox(self._next)
        self._piece = Piece(b"", False)
        self._has_piece = asyncio.Event()
        self._written = asyncio.Event()

    @staticmethod
    async def open(address: Address, endpoint: str, token: str) -> Connection:
        """Dial and wait for the session status of a server that knows features."""
        socket = await address.dial(endpoint, token)
        given = socket.response.headers.get(FEATURES_HEADER) if socket.response is not None else None
        features = FEATURES & {name.strip() for name in (given or "").split(",")}
        connection = Connection(socket, features, endpoint)
        if given is not None:
            try:
                connection.session = await connection._first_status()
            except BaseException:
                await connection.close()
                raise
        return connection

    async def _first_status(self) -> Session:
        try:
            async with asyncio.timeout(SESSION_TIMEOUT):
                first = self._text(await self._socket.recv(decode=False))
        except (TimeoutError, ConnectionClosed) as error:
            raise Unavailable(f"{self.endpoint} did not open a session: {error or 'no answer'}") from None
        if isinstance(first, Status) and isinstance(first.data, Session):
            return first.data
        raise Unavailable(f"{self.endpoint} grants features, but its first frame is not the session status")

    def put(self, source: str, pieces: Iterator[Piece], keep: int | None = None) -> int:
        """Queue frames of one source; see `Outbox.put`."""
        return self._outbox.put(source.encode(), pieces, keep)

    def put_message(self, source: str, text: bytes, blobs: Mapping[str, Buffer], keep: int | None = None) -> int:
        """Queue a text frame and its blobs."""
        return self.put(source, self._pieces(text, blobs), keep)

    def put_text(self, source: str, text: bytes, sent: Callable[[], None]) -> None:
        """Queue a text frame; `sent` is called when it has been written."""

        def pieces() -> Iterator[Piece]:
            yield Piece(text, True)
            sent()

        self.put(source, pieces())

    def room(self, source: str) -> asyncio.Future[None] | None:
        """See `Outbox.room`."""
        return self._outbox.room(source.encode())

    async def receive(self) -> AsyncGenerator[Incoming, None]:
        """What comes in, until the socket is gone; errors are the server's faults, which do not end the connection."""
        sender = asyncio.create_task(self._send())
        try:
            while True:
                payload = await self._socket.recv(decode=False)
                try:
                    incoming = self._take(payload)
                except RceError as error:
                    incoming = error
                if incoming is not None:
                    yield incoming
                for late in self._sweep():
                    yield late
        except ConnectionClosed:
            return
        finally:
            sender.cancel()
            await asyncio.wait([sender])
            self._outbox.clear()  # last, so that nobody waits for room in it after this
            self._written.set()

    async def flush(self) -> None:
        """Wait until all that is queued has been written, or until that takes too long or the socket is gone."""
        try:
            async with asyncio.timeout(FLUSH_TIMEOUT):
                while not self._outbox.empty:
                    self._written.clear()
                    await self._written.wait()
        except TimeoutError:
            log.warning("%s does not take what is queued; it is lost", self.endpoint)

    async def close(self) -> None:
        """Close with code 1000: the robot is leaving for good."""
        await self._socket.close()

    @property
    def reason(self) -> str:
        """Why the socket was closed, as far as it is known."""
        return self._socket.close_reason or f"code {self._socket.close_code or 1006}"

    def _pieces(self, text: bytes, blobs: Mapping[str, Buffer]) -> Iterator[Piece]:
        yield Piece(text, True)
        for frame in binary_frames(blobs, "parts" in self.features):
            yield Piece(frame.join(), False)

    def _next(self, piece: Piece) -> bool:
        self._piece = piece
        self._has_piece.set()
        return False  # one at a time: the next is chosen when this one has left

    async def _send(self) -> None:
        while True:
            await self._has_piece.wait()
            self._has_piece.clear()
            try:
                await self._socket.send(self._piece.payload, text=self._piece.text)
                self._outbox.resume()
            except ConnectionClosed:
                return
            except Exception:
                self._socket.transport.abort()  # a socket on which nothing is sent any more must not look alive
                raise
            self._written.set()

    def _take(self, payload: bytes) -> Incoming | None:
        """Text and binary frames are told apart by their first byte: JSON objects do not begin with a hex digit."""
        if payload[:1] in (b"{", b" ", b"\t", b"\n", b"\r"):
            return self._text(payload)
        return self._whole(self._assembler.blob(payload))

    def _text(self, payload: bytes) -> Incoming | None:
        frame = decode_frame(payload)
        if frame.type == "DM":
            # Without a star there are no blobs to look for, which takes longer.
            return self._whole(self._assembler.frame(frame) if b"*" in payload else Outcome(Assembled(frame, {})))
        if frame.type == "ST":
            return _status(frame)
        if frame.type == "ER":
            return decode_as(Failure, payload, "ER")
        raise InvalidRequest(f"the server sent a frame of the unknown type {frame.type!r}")

    def _whole(self, outcome: Outcome) -> Incoming | None:
        if outcome.dropped:
            return outcome.dropped[0].error
        if outcome.complete is None:
            return None
        frame, blobs = outcome.complete
        return Message(decode_as(DataMessage, frame.data, "DM"), blobs)

    def _sweep(self) -> list[RceError]:
        now = time.monotonic()
        if now - self._swept < SWEEP:
            return []
        self._swept = now
        return [
            TimedOut(f"a message of the server never got its blobs: {each.error}") for each in self._assembler.sweep()
        ]


def _status(frame: Frame) -> Status | None:
    """None for a topic that this version does not know: later servers may have more."""
    kind = _topics.get(decode_as(_Topic, frame.data, "ST").topic)
    return Status(decode_as(kind, frame.data, "ST"), frame.id) if kind is not None else None


class _Topic(msgspec.Struct):
    topic: str


_topics: dict[str, type[StatusData]] = {str(kind.__struct_config__.tag): kind for kind in get_args(StatusData)}
