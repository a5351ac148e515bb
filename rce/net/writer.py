"""Writer in front of a transport that joins small writes.

A transport of uvloop makes a system call for each write, and the other side wakes up for each. So the first small write
of a pass of the event loop goes out at once, and those that follow it in the same pass go out together in the next one.
A single message is not delayed, not even among large ones. A flood costs one system call for many messages.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

Buffer = bytes | bytearray | memoryview

SMALL = 4 * 1024  # bytes of a write that waits for others
MOST = 16 * 1024  # bytes that wait


class Writer:
    """Writer of one transport."""

    __slots__ = ("_size", "_transport", "_waiting", "_written")

    def __init__(self, transport: asyncio.WriteTransport) -> None:
        self._transport = transport
        self._waiting: list[Buffer] = []
        self._size = 0
        self._written = False  # a small write has gone out in this pass of the loop

    def write(self, buffers: Sequence[Buffer]) -> bool:
        """Write buffers one after the other; return False if they wait for the next pass."""
        size = sum(map(len, buffers))
        if size < SMALL and self._written:
            self._waiting += buffers
            self._size += size
            if self._size >= MOST:
                self.flush()
            return not self._waiting
        self.flush()
        self._transport.writelines(buffers)
        if size < SMALL:
            self._written = True
            asyncio.get_running_loop().call_soon(self._next_pass)
        return True

    def flush(self) -> None:
        """Write what waits now. Call it before the transport is closed, or written to directly."""
        waiting, self._waiting, self._size = self._waiting, [], 0
        if waiting and not self._transport.is_closing():
            self._transport.writelines(waiting)

    def _next_pass(self) -> None:
        self._written = bool(self._waiting)
        if self._written:
            asyncio.get_running_loop().call_soon(self._next_pass)
            self.flush()
