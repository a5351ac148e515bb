"""A terminal in an environment: what its node there and its client say to each other, over two topics of bytes.

A message begins with a letter that says what it is. Both ways goes a stream of bytes in pieces with their offset: at
most WINDOW of it is under way, and what the other side has not taken in time is sent again. So nothing is lost or twice
there, however fast a program writes and whatever breaks between; who reads slowly slows the program down.
"""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Callable
from typing import NamedTuple

OPEN = b"o"  # client: a Request; said again until the answer
READY = b"r"  # node: the terminal is there
SIZE = b"s"  # client: rows and columns
DATA = b"d"  # both: an offset, and bytes
TAKEN = b"t"  # both: the offset up to which all was taken
HERE = b"h"  # client: every HERE_EVERY, so that the node knows when it has vanished
EXIT = b"x"  # node: the exit status and the offset of the end; said again until BYE
BYE = b"b"  # client: hang up

WINDOW = 256 * 1024
PIECE = 16 * 1024
AGAIN_FIRST, AGAIN_MOST = 1.0, 8.0  # seconds without progress after which bytes are sent again
HERE_EVERY = 2.0
GONE = 20.0  # seconds of silence after which a client has vanished: longer than a robot's time to come back
MESSAGE = "std_msgs/UInt8MultiArray"

_offset = struct.Struct("<Q")
_pair = struct.Struct("<HH")
_end = struct.Struct("<iQ")
_cdr = struct.Struct("<4sIII")  # encapsulation, no dimensions, no offset, length
LITTLE_ENDIAN = b"\0\1\0\0"


class Request(NamedTuple):
    """The terminal that a client wants; without a command an interactive shell."""

    rows: int
    columns: int
    term: str
    command: str = ""

    def encode(self) -> bytes:
        return OPEN + json.dumps(self._asdict()).encode()

    @staticmethod
    def decode(content: bytes) -> Request:
        return Request(**json.loads(content))


class Outgoing:
    """The stream to the other side."""

    def __init__(self, send: Callable[[bytes], object], clock: Callable[[], float] = time.monotonic) -> None:
        self._send = send
        self._clock = clock
        self._base = 0  # taken by the other side
        self._waiting = bytearray()  # from there on
        self._patience = AGAIN_FIRST
        self._since = clock()

    @property
    def room(self) -> int:
        """Bytes that may be put now."""
        return max(0, WINDOW - len(self._waiting))

    @property
    def end(self) -> int:
        return self._base + len(self._waiting)

    @property
    def all_taken(self) -> bool:
        return not self._waiting

    def put(self, data: bytes) -> None:
        if not self._waiting:
            self._since = self._clock()
        start = len(self._waiting)
        self._waiting += data
        self._send_from(start)

    def taken(self, content: bytes) -> None:
        (total,) = _offset.unpack(content)
        if total > self._base:
            del self._waiting[: total - self._base]
            self._base, self._since, self._patience = total, self._clock(), AGAIN_FIRST

    def tick(self) -> None:
        """Now and then: sends again what has been under way for too long."""
        if self._waiting and self._clock() - self._since > self._patience:
            self._since = self._clock()
            self._patience = min(2 * self._patience, AGAIN_MOST)
            self._send_from(0)

    def _send_from(self, start: int) -> None:
        for at in range(start, len(self._waiting), PIECE):
            self._send(DATA + _offset.pack(self._base + at) + self._waiting[at : at + PIECE])


class Incoming:
    """The stream from the other side."""

    def __init__(self) -> None:
        self.end = 0

    def take(self, content: bytes) -> bytes:
        """What a piece has that is new; nothing of one that comes again, or before another that is missing."""
        (offset,) = _offset.unpack_from(content)
        known = self.end - offset
        fresh = content[_offset.size + known :] if known >= 0 else b""
        self.end += len(fresh)
        return fresh

    def acknowledgement(self) -> bytes:
        return TAKEN + _offset.pack(self.end)


def size_frame(rows: int, columns: int) -> bytes:
    return SIZE + _pair.pack(rows, columns)


def read_size(content: bytes) -> tuple[int, int]:
    return _pair.unpack(content)


def exit_frame(status: int, end: int) -> bytes:
    return EXIT + _end.pack(status, end)


def read_exit(content: bytes) -> tuple[int, int]:
    return _end.unpack(content)


def to_cdr(data: bytes) -> bytes:
    """The serialized `std_msgs/UInt8MultiArray` of these bytes."""
    return _cdr.pack(LITTLE_ENDIAN, 0, 0, len(data)) + data


def from_cdr(message: bytes) -> bytes:
    return message[_cdr.size : _cdr.size + _cdr.unpack_from(message)[3]]
