"""Frames of WebSockets (RFC 6455, section 5), made, parsed and unmasked in less time than Autobahn needs."""

from __future__ import annotations

from collections.abc import Sequence

from msgspec import Struct
from websockets.speedups import apply_mask

from rce.protocol.blobs import BinaryFrame, Buffer, TextFrame

TEXT, BINARY = 0x81, 0x82  # first byte of a final frame
MASKED = 0x80  # bit of the second byte
LONG, VERY_LONG = 126, 127  # in place of a length in the second byte: it follows in 2 or 8 bytes


class Unmasker:
    """Unmasks a frame (section 5.3) in one pass over the data; Autobahn's own masker makes four."""

    def __init__(self, mask: Buffer, _length: int) -> None:
        self._mask = bytes(mask)
        self._done = 0

    def pointer(self) -> int:
        """Return the number of bytes that were unmasked."""
        return self._done

    def process(self, data: Buffer) -> bytes:
        """Return the next bytes of the frame unmasked."""
        turn = self._done % 4
        self._done += len(data)
        return apply_mask(data, self._mask[turn:] + self._mask[:turn])


class Received(Struct, frozen=True, gc=False):
    """A message at the beginning of received data, and the number of bytes that its frame has."""

    payload: bytes
    is_binary: bool
    size: int


def first_message(data: memoryview, limit: int) -> Received | None:
    """Return the message at the beginning of received data if it is complete, in one frame, and below 64 kB.

    Autobahn parses all other frames, and finds violations of the protocol. A small message takes a third less time
    without its callbacks for the beginning, the data and the end of each frame and message.

    Args:
        data: Received bytes, from the beginning of a frame.
        limit: Bytes of the largest message that the robot may send.
    """
    if len(data) < 6 or not TEXT <= data[0] <= BINARY:
        return None
    length, start = data[1] - MASKED, 2
    if length == LONG and len(data) >= 8:
        length, start = data[2] << 8 | data[3], 4
        if length < LONG:  # it must be in the second byte
            return None
    elif not 0 <= length < LONG:
        return None
    payload = start + 4
    end = payload + length
    if length > limit or len(data) < end:
        return None
    return Received(apply_mask(data[payload:end], bytes(data[start:payload])), data[0] == BINARY, end)


def framed(frame: Buffer | BinaryFrame | TextFrame) -> tuple[Buffer, Buffer]:
    """Return one final, unmasked frame (section 5.2) as its head and its data; a buffer is text."""
    kind = BINARY if isinstance(frame, BinaryFrame) else TEXT
    head, data = frame if isinstance(frame, tuple) else (b"", frame)
    size = len(head) + len(data)
    if size < LONG:
        begin = bytes((kind, size))
    elif size < 1 << 16:
        begin = bytes((kind, LONG)) + size.to_bytes(2)
    else:
        begin = bytes((kind, VERY_LONG)) + size.to_bytes(8)
    return begin + head, data


def framed_all(piece: Sequence[Buffer | BinaryFrame | TextFrame]) -> Sequence[Buffer]:
    """Return the frames of several messages as the buffers to write one after the other."""
    if len(piece) == 1:
        return framed(piece[0])
    return [part for frame in piece for part in framed(frame)]
