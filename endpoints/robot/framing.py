"""Frames of WebSockets (RFC 6455, section 5), made and unmasked with fewer copies than Autobahn needs."""

from __future__ import annotations

from websockets.speedups import apply_mask

from rce.protocol.blobs import BinaryFrame, Buffer, TextFrame

TEXT, BINARY = b"\x81", b"\x82"  # first bytes of final frames


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


def framed(frame: Buffer | BinaryFrame | TextFrame) -> tuple[Buffer, Buffer]:
    """Return one final, unmasked frame (section 5.2) as its head and its data; a buffer is text."""
    kind = BINARY if isinstance(frame, BinaryFrame) else TEXT
    head, data = (b"", frame) if isinstance(frame, Buffer) else frame
    size = len(head) + len(data)
    if size < 126:
        length = bytes([size])
    elif size < 1 << 16:
        length = b"\x7e" + size.to_bytes(2)
    else:
        length = b"\x7f" + size.to_bytes(8)
    return kind + length + head, data
