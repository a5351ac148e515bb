"""Bounded queues in front of one stream, served round robin so that large messages do not delay small ones.

Each source (an interface) has its own queue. A message is a sequence of pieces, and the stream takes one piece from
each source in turn. So a velocity command waits for at most one piece of each image that is being sent. The messages of
one source stay in order. The queue of a topic keeps the newest messages and counts those that it drops; a queue without
a bound makes its sender wait (`wait_for_room`).
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

P = TypeVar("P")
HIGH_WATER = 8  # messages in an unbounded queue at which its sender must wait


class _Queue(Generic[P]):
    """Queue of one source: the message that is being sent, and those that wait."""

    __slots__ = ("current", "drained", "waiting")

    def __init__(self) -> None:
        self.current: Iterator[P] | None = None
        self.waiting: deque[Iterator[P]] = deque()
        self.drained: asyncio.Future[None] | None = None


class Outbox(Generic[P]):
    """Queues of all sources of one stream.

    `write` writes a piece to the stream and returns True if the stream has room for another.
    """

    def __init__(self, write: Callable[[P], bool]) -> None:
        self._write = write
        self._queues: dict[bytes, _Queue[P]] = {}
        self._turns: deque[bytes] = deque()
        self._open = True

    def put(self, source: bytes, pieces: Iterator[P], keep: int | None) -> int:
        """Queue a message.

        Args:
            source: Source of the message.
            pieces: The pieces of the message.
            keep: Number of messages of the source that may wait, the newest; None for all.

        Returns:
            The number of older messages of the source that were dropped.
        """
        queue = self._queues.get(source)
        if queue is None:
            queue = self._queues[source] = _Queue()
            self._turns.append(source)
        queue.waiting.append(pieces)
        dropped = 0
        if self._open:
            self._pump()
        elif keep is not None:
            while len(queue.waiting) > keep:
                queue.waiting.popleft()
                dropped += 1
        return dropped

    @property
    def empty(self) -> bool:
        """True if all messages were written to the stream."""
        return not self._turns

    def backlog(self, source: bytes) -> int:
        """Return the number of messages of `source` that wait; one that is being sent does not count."""
        queue = self._queues.get(source)
        return len(queue.waiting) if queue else 0

    @property
    def waiting(self) -> int:
        """Number of messages of all sources that wait; those that are being sent do not count."""
        return sum(len(queue.waiting) for queue in self._queues.values())

    def wait_for_room(self, source: bytes) -> asyncio.Future[None] | None:
        """Return None while `source` may send, else a future that is done when its queue is empty."""
        queue = self._queues.get(source)
        if queue is None or len(queue.waiting) < HIGH_WATER:
            return None
        if queue.drained is None:
            queue.drained = asyncio.get_running_loop().create_future()
        return queue.drained

    def discard(self, source: bytes) -> None:
        """Drop the waiting messages of `source`; one that is being sent is completed."""
        queue = self._queues.get(source)
        if queue is not None:
            queue.waiting.clear()
            self._release(queue)

    def abort_current(self) -> None:
        """Drop the messages that are being sent, because the stream broke."""
        for queue in self._queues.values():
            queue.current = None

    def clear(self) -> None:
        """Drop all messages and stop writing, because the stream is gone."""
        for queue in self._queues.values():
            self._release(queue)
        self._queues.clear()
        self._turns.clear()
        self._open = False

    def pause(self) -> None:
        """Stop writing to the stream."""
        self._open = False

    def resume(self) -> None:
        """Write to the stream until it is full."""
        self._open = True
        self._pump()

    def _pump(self) -> None:
        while self._open and self._turns:
            source = self._turns[0]
            self._turns.rotate(-1)  # first, because the calls below may raise or call `put`
            queue = self._queues[source]
            if queue.current is None and queue.waiting:
                queue.current = queue.waiting.popleft()
            piece = next(queue.current, None) if queue.current is not None else None
            if piece is not None:
                self._open = self._write(piece)
                continue
            queue.current = None
            if not queue.waiting:
                self._turns.remove(source)
                del self._queues[source]
                self._release(queue)

    @staticmethod
    def _release(queue: _Queue[P]) -> None:
        if queue.drained is not None and not queue.drained.done():
            queue.drained.set_result(None)
        queue.drained = None
