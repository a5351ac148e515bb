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


class Passes:
    """Counter of the passes of an event loop, which all writers of the loop share.

    Attributes:
        number: Number of the pass in progress.
    """

    def __init__(self) -> None:
        self.number = 1
        self._waiting: list[Writer] = []
        self._used = False  # a writer has asked for the number of this pass

    def use(self) -> int:
        """Return the number of this pass, and count on in the next one."""
        if not self._used:
            self._used = True
            asyncio.get_running_loop().call_soon(self._next)
        return self.number

    def flush_in_next(self, writer: Writer) -> None:
        """Flush a writer in the next pass. It has written in this one, so the next one is counted."""
        self._waiting.append(writer)

    def _next(self) -> None:
        self.number += 1
        self._used = False
        waiting, self._waiting = self._waiting, []
        for writer in waiting:
            writer.flush_in_pass()


class Writer:
    """Writer of one transport."""

    __slots__ = ("_last", "_passes", "_size", "_transport", "_waiting")

    def __init__(self, transport: asyncio.WriteTransport, passes: Passes) -> None:
        self._transport = transport
        self._passes = passes
        self._waiting: list[Buffer] = []
        self._size = 0
        self._last = 0  # number of the last pass in which a small write has gone out

    def write(self, buffers: Sequence[Buffer]) -> bool:
        """Write buffers one after the other; return False if they wait for the next pass."""
        size = sum(map(len, buffers))
        if size < SMALL and self._last == self._passes.number:
            if not self._waiting:
                self._passes.flush_in_next(self)
            self._waiting += buffers
            self._size += size
            if self._size >= MOST:
                self.flush()
            return not self._waiting
        if self._waiting:
            self.flush()
        self._transport.writelines(buffers)
        if size < SMALL:
            self._last = self._passes.use()
        return True

    def flush(self) -> None:
        """Write what waits now. Call it before the transport is closed, or written to directly."""
        waiting, self._waiting, self._size = self._waiting, [], 0
        if waiting and not self._transport.is_closing():
            self._transport.writelines(waiting)

    def flush_in_pass(self) -> None:
        """Write what waits; small writes that follow in this pass wait for the next one."""
        if self._waiting:
            self._last = self._passes.use()
            self.flush()
