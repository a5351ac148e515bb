"""Frames of a data link, which carry messages between the interfaces of two endpoints.

    flags 1 | length of message id 1 | stream 4 | payload bytes in this frame 4 | payload bytes in all 4  (big-endian)
    first frame of a message only: source 16 | destination 16 if DESTINATION | message id
        and, if the phase is SHARED: number of senders 1 | senders 16 each
    payload

A message of more than `PART` bytes is split into several frames with the same stream number, and frames of other
messages may come in between. The receiver reads large payloads directly into their final buffer, whose memory grows
with what arrives: a first frame may announce more than ever follows.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from time import perf_counter
from typing import Any

from rce.errors import LimitExceeded
from rce.protocol.buffers import uninitialized

HEAD = struct.Struct("!BBIII")
FIRST, DESTINATION, ERROR, NUMBERED = 1, 2, 4, 8
PHASE = 4  # the bits of the flags above these: the phase
SHARED = 15  # in place of the phase of a message that several interfaces send
MAX_SENDERS = 255  # of one message
PART = 256 * 1024
MAX_MESSAGE = 80 * 1024 * 1024  # a 64 MB WebSocket message grows a little when it is converted to CDR
MAX_UNFINISHED = 4 * MAX_MESSAGE
MAX_STREAMS = 4096
SCRATCH = 16 * 1024  # bytes of small frames that are parsed at a stretch; larger payloads are read past this buffer

Buffer = bytes | bytearray | memoryview


class Phase(IntEnum):
    """Phase of a goal to which a message belongs; topics and services have none.

    The side that asks sends the first four, the side that carries out the goal sends the others, and CANCEL when it has
    accepted to cancel. A leased goal is canceled when its asker is lost. RESULT asks for the result again.
    """

    NONE = 0
    GOAL = 1
    LEASED_GOAL = 2
    CANCEL = 3
    RESULT = 4
    ACCEPTED = 5
    REJECTED = 6
    FEEDBACK = 7
    SUCCEEDED = 8
    CANCELED = 9
    ABORTED = 10


_PHASES = tuple(Phase)


@dataclass(slots=True)
class Message:
    """Message from one interface to all its peers, or to one of them.

    Attributes:
        source: Id of the sending interface, or of what it shares with others.
        msg_id: Message id, which connects a response with its request.
        payload: Serialized ROS message (CDR with its encapsulation header); with `error`, an ErrorInfo as msgpack.
        destination: Id of the only peer that gets the message; None for all peers.
        error: True for the answer to a service request that failed, or the end of a goal that failed.
        numbered: True if the platform gave the message id to a message that had none.
        phase: Phase of a message of an action; its `msg_id` is the goal's UUID in hex digits.
        senders: Ids of the interfaces that send this message of a topic together; without any, `source` sends it.
        series: Id of the messages among which this one is the next: those of one source; not transmitted.
        entered_at: `time.perf_counter` when the message came into this process; not transmitted.
        conversions: What this process has made of the payload, by form, for all who want the same; not transmitted.

    Raises:
        LimitExceeded: The payload is too large for a data link.
    """

    source: bytes
    msg_id: str
    payload: Buffer
    destination: bytes | None = None
    error: bool = False
    phase: Phase = Phase.NONE
    numbered: bool = False
    senders: tuple[bytes, ...] = ()
    series: bytes = field(default=b"", compare=False, repr=False)
    entered_at: float = field(default_factory=perf_counter, compare=False, repr=False)
    conversions: dict[Any, Any] = field(default_factory=dict, compare=False, repr=False)

    def __post_init__(self) -> None:
        if len(self.payload) > MAX_MESSAGE:  # here, where its sender can be told: the other end would break the link
            raise LimitExceeded(
                f"a message of {len(self.payload)} bytes exceeds the {MAX_MESSAGE} bytes of a data link",
                bytes=MAX_MESSAGE,
            )
        self.series = self.series or self.source

    def by_sender(self) -> Sequence[Message]:
        """Return this message as each of its senders would send it alone; what is made of it stays common."""
        if not self.senders:
            return (self,)
        return [
            Message(
                sender,
                self.msg_id,
                self.payload,
                self.destination,
                self.error,
                numbered=self.numbered,
                series=self.series,
                entered_at=self.entered_at,
                conversions=self.conversions,
            )
            for sender in self.senders
        ]


def pieces(message: Message, stream: int) -> Iterator[list[Buffer]]:
    """Yield the frames of a message, each as the buffers to write one after the other."""
    payload = memoryview(message.payload)
    total = len(payload)
    name = message.msg_id.encode()
    flags = FIRST | (ERROR if message.error else 0) | (DESTINATION if message.destination else 0)
    flags |= (NUMBERED if message.numbered else 0) | (SHARED if message.senders else message.phase) << PHASE
    first = min(total, PART)
    head = HEAD.pack(flags, len(name), stream, first, total) + message.source + (message.destination or b"") + name
    if message.senders:
        head += bytes([len(message.senders)]) + b"".join(message.senders)
    if total <= 16 * 1024:
        yield [head + message.payload]  # one small buffer: one system call
        return
    yield [head, payload[:first]]
    for start in range(first, total, PART):
        part = payload[start : start + PART]
        yield [HEAD.pack(0, 0, stream, len(part), total), part]


def _head(buffer: bytearray, start: int) -> tuple[int, int, int, int, int]:
    return HEAD.unpack_from(buffer, start)


@dataclass(slots=True)
class _Unfinished:
    """Message whose last frame has not come yet."""

    stream: int
    message: Message
    content: bytes
    buffer: memoryview  # of the content
    filled: int = 0


class FrameReader:
    """Incremental parser of frames, used like an `asyncio.BufferedProtocol`."""

    def __init__(self) -> None:
        self._scratch = bytearray(SCRATCH)
        self._view = memoryview(self._scratch)
        self._have = 0
        self._streams: dict[int, _Unfinished] = {}
        self._unfinished = 0  # total size of the unfinished messages' buffers
        self._direct: _Unfinished | None = None  # the payload that is being read directly into its buffer
        self._direct_end = 0

    def get_buffer(self) -> memoryview:
        """Return the buffer for the next bytes of the stream."""
        if self._direct is not None:
            return self._direct.buffer[self._direct.filled : self._direct_end]
        if self._streams and self._have < HEAD.size:  # only the head, so that the payload after it is read directly
            return self._view[self._have : HEAD.size]
        return self._view[self._have :]

    def buffer_updated(self, count: int) -> list[Message]:
        """Parse `count` bytes that were written to the buffer; return the messages that they complete.

        Raises:
            LimitExceeded: The peer exceeds a limit or sends a frame that belongs to no message.
            UnicodeDecodeError: A message id is not UTF-8.
        """
        done: list[Message] = []
        if self._direct is not None:
            self._direct.filled += count
            if self._direct.filled == self._direct_end:
                self._finish(self._direct, done)
                self._direct = None
            return done
        self._have += count
        position = 0
        while True:
            used = self._parse(position, done)
            if used == 0:
                break
            position += used
        self._view[: self._have - position] = self._view[position : self._have]
        self._have -= position
        return done

    def _parse(self, start: int, done: list[Message]) -> int:
        """Parse one frame, or the received part of it, from the scratch buffer; return the number of bytes consumed."""
        have = self._have - start
        if have < HEAD.size or self._direct is not None:
            return 0
        flags, name_length, stream, size, total = _head(self._scratch, start)
        body = start + HEAD.size
        if flags & FIRST:
            ids = 32 if flags & DESTINATION else 16
            if have < HEAD.size + ids + name_length:
                return 0
            if total > MAX_MESSAGE or size > total:
                raise LimitExceeded(f"a message of {total} bytes exceeds the {MAX_MESSAGE} bytes of a data link")
            ends = body + ids
            source = bytes(self._view[body : body + 16])
            destination = bytes(self._view[body + 16 : ends]) if flags & DESTINATION else None
            name = str(self._view[ends : ends + name_length], "utf-8")
            body = ends + name_length
            phase = flags >> PHASE
            senders: tuple[bytes, ...] = ()
            if phase == SHARED:
                count = self._scratch[body] if body < self._have else 0
                if self._have < body + 1 + 16 * count or body >= self._have:
                    return 0
                senders = tuple(bytes(self._view[at : at + 16]) for at in range(body + 1, body + 1 + 16 * count, 16))
                body, phase = body + 1 + 16 * count, Phase.NONE
            if phase >= len(_PHASES):
                raise LimitExceeded("a data link sent a message of an unknown phase")
            error, numbered = bool(flags & ERROR), bool(flags & NUMBERED)
            sender = source
            if len(senders) == 1:  # as `by_sender` would return it
                sender, senders = senders[0], ()
            message = Message(sender, name, b"", destination, error, _PHASES[phase], numbered, senders, source)
            if size == total and self._have - body >= size:
                message.payload = bytes(self._view[body : body + size])
                done.append(message)
                return body + size - start
            unfinished = self._begin(stream, message, total)
        else:
            found = self._streams.get(stream)
            if found is None or found.filled + size > len(found.buffer):
                raise LimitExceeded("a data link sent a frame that belongs to no message")
            unfinished = found
        take = min(size, self._have - body)
        end = unfinished.filled + take
        unfinished.buffer[unfinished.filled : end] = self._view[body : body + take]
        unfinished.filled = end
        if take < size:
            self._direct, self._direct_end = unfinished, end + size - take
        else:
            self._finish(unfinished, done)
        return body + take - start

    def _begin(self, stream: int, message: Message, total: int) -> _Unfinished:
        if stream in self._streams:
            raise LimitExceeded("a data link began a message in a stream that has an unfinished one")
        if self._unfinished + total > MAX_UNFINISHED or len(self._streams) >= MAX_STREAMS:
            raise LimitExceeded(
                f"a data link has more than {MAX_STREAMS} unfinished messages, or more than {MAX_UNFINISHED} bytes of "
                "them"
            )
        self._unfinished += total
        begun = self._streams[stream] = _Unfinished(stream, message, *uninitialized(total))
        return begun

    def _finish(self, unfinished: _Unfinished, done: list[Message]) -> None:
        if unfinished.filled < len(unfinished.buffer):
            return
        unfinished.message.payload = unfinished.content
        done.append(unfinished.message)
        del self._streams[unfinished.stream]
        self._unfinished -= len(unfinished.buffer)
