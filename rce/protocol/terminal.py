"""Protocol between a terminal node in an environment and its client, over two topics of bytes.

A message begins with a letter that identifies its kind. In each direction goes a byte stream in chunks with their
offsets. At most WINDOW bytes are in flight; bytes that are not acknowledged in time are sent again. So no bytes are
lost or duplicated, however fast a program writes and whatever connection breaks in between, and a slow reader slows the
program down.
"""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Callable
from typing import NamedTuple

OPEN = b"o"  # client: a Request; repeated until READY
READY = b"r"  # node: the terminal is open
SIZE = b"s"  # client: rows and columns
DATA = b"d"  # both: an offset, and bytes
ACK = b"t"  # both: the offset up to which all bytes were received
KEEPALIVE = b"h"  # client: every KEEPALIVE_INTERVAL, so that the node notices when the client is gone
EXIT = b"x"  # node: the exit status and the offset of the end of the stream; repeated until HANG_UP
HANG_UP = b"b"  # client: end the terminal

WINDOW = 256 * 1024  # bytes
CHUNK = 16 * 1024
RETRANSMIT_MIN, RETRANSMIT_MAX = 1.0, 8.0  # seconds without progress until bytes are sent again
KEEPALIVE_INTERVAL = 2.0
CLIENT_TIMEOUT = 20.0  # seconds of silence until a client counts as gone: longer than the grace period of a robot
MESSAGE = "std_msgs/UInt8MultiArray"

_offset = struct.Struct("<Q")
_pair = struct.Struct("<HH")
_end = struct.Struct("<iQ")
_cdr = struct.Struct("<4sIII")  # encapsulation header, no dimensions, data offset 0, length
LITTLE_ENDIAN = b"\0\1\0\0"


class Request(NamedTuple):
    """Request for a terminal; without a command it runs an interactive shell."""

    rows: int
    columns: int
    term: str
    command: str = ""

    def encode(self) -> bytes:
        """Return the OPEN message."""
        return OPEN + json.dumps(self._asdict()).encode()

    @staticmethod
    def decode(content: bytes) -> Request:
        """Decode an OPEN message without its letter."""
        return Request(**json.loads(content))


class SendStream:
    """Byte stream to the other side: splits it into DATA messages and sends them again until acknowledged."""

    def __init__(self, send: Callable[[bytes], object], clock: Callable[[], float] = time.monotonic) -> None:
        self._send = send
        self._clock = clock
        self._base = 0  # offset up to which all bytes are acknowledged
        self._unacknowledged = bytearray()  # the bytes from there on
        self._timeout = RETRANSMIT_MIN
        self._progress_at = clock()

    @property
    def room(self) -> int:
        """Number of bytes that may be written now."""
        return max(0, WINDOW - len(self._unacknowledged))

    @property
    def end(self) -> int:
        """Offset of the end of the stream so far."""
        return self._base + len(self._unacknowledged)

    @property
    def all_acknowledged(self) -> bool:
        """True if the other side has received everything."""
        return not self._unacknowledged

    def write(self, data: bytes) -> None:
        """Append bytes to the stream and send them."""
        if not self._unacknowledged:
            self._progress_at = self._clock()
        start = len(self._unacknowledged)
        self._unacknowledged += data
        self._send_from(start)

    def acknowledged(self, content: bytes) -> None:
        """Process an ACK message without its letter."""
        (total,) = _offset.unpack(content)
        if total > self._base:
            del self._unacknowledged[: total - self._base]
            self._base, self._progress_at, self._timeout = total, self._clock(), RETRANSMIT_MIN

    def tick(self) -> None:
        """Send unacknowledged bytes again if it is time. Call it several times per second."""
        if self._unacknowledged and self._clock() - self._progress_at > self._timeout:
            self._progress_at = self._clock()
            self._timeout = min(2 * self._timeout, RETRANSMIT_MAX)
            self._send_from(0)

    def _send_from(self, start: int) -> None:
        for at in range(start, len(self._unacknowledged), CHUNK):
            self._send(DATA + _offset.pack(self._base + at) + self._unacknowledged[at : at + CHUNK])


class ReceiveStream:
    """Byte stream from the other side: drops duplicates, and chunks that come before a missing one."""

    def __init__(self) -> None:
        self.end = 0

    def receive(self, content: bytes) -> bytes:
        """Process a DATA message without its letter; return its new bytes, none if an earlier chunk is missing."""
        (offset,) = _offset.unpack_from(content)
        known = self.end - offset
        fresh = content[_offset.size + known :] if known >= 0 else b""
        self.end += len(fresh)
        return fresh

    def acknowledgement(self) -> bytes:
        """Return the ACK message for everything received so far."""
        return ACK + _offset.pack(self.end)


def size_frame(rows: int, columns: int) -> bytes:
    """Return a SIZE message."""
    return SIZE + _pair.pack(rows, columns)


def read_size(content: bytes) -> tuple[int, int]:
    """Decode a SIZE message without its letter; return rows and columns."""
    return _pair.unpack(content)


def exit_frame(status: int, end: int) -> bytes:
    """Return an EXIT message with the exit status and the offset of the end of the stream."""
    return EXIT + _end.pack(status, end)


def read_exit(content: bytes) -> tuple[int, int]:
    """Decode an EXIT message without its letter; return the exit status and the offset of the end of the stream."""
    return _end.unpack(content)


def to_cdr(data: bytes) -> bytes:
    """Serialize bytes as a `std_msgs/UInt8MultiArray`."""
    return _cdr.pack(LITTLE_ENDIAN, 0, 0, len(data)) + data


def from_cdr(message: bytes) -> bytes:
    """Return the bytes of a serialized `std_msgs/UInt8MultiArray`."""
    return message[_cdr.size : _cdr.size + _cdr.unpack_from(message)[3]]
