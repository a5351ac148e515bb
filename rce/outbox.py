"""Bounded queues in front of one stream, emptied in turns so that a large message does not hold up small ones.

Each source (an interface) has its own queue. A message is a sequence of pieces; the stream takes one piece from each
source in turn (round robin), so a velocity command waits for at most one piece of each image that is on its way.
Within a source order is kept. A topic's queue keeps the newest messages and counts what it drops; a queue without a
limit makes its sender wait (`room`).
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

P = TypeVar("P")
HIGH_WATER = 8  # messages in a keep-all queue at which its sender is asked to wait


class _Queue(Generic[P]):
    __slots__ = ("current", "room", "waiting")

    def __init__(self) -> None:
        self.current: Iterator[P] | None = None
        self.waiting: deque[Iterator[P]] = deque()
        self.room: asyncio.Future[None] | None = None


class Outbox(Generic[P]):
    """`write` takes a piece to the stream and says whether the stream has room for another."""

    def __init__(self, write: Callable[[P], bool]) -> None:
        self._write = write
        self._queues: dict[bytes, _Queue[P]] = {}
        self._turns: deque[bytes] = deque()
        self._open = True

    def put(self, source: bytes, pieces: Iterator[P], keep: int | None) -> int:
        """Queue a message; `keep` is how many may wait (None: all). Returns how many older ones were dropped for it."""
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
        """Whether all has left."""
        return not self._turns

    def backlog(self, source: bytes) -> int:
        """How many messages of this source have not begun to leave."""
        queue = self._queues.get(source)
        return len(queue.waiting) if queue else 0

    @property
    def waiting(self) -> int:
        """How many messages of all sources have not begun to leave."""
        return sum(len(queue.waiting) for queue in self._queues.values())

    def room(self, source: bytes) -> asyncio.Future[None] | None:
        """None while the source may go on; else what is done once its queue has emptied."""
        queue = self._queues.get(source)
        if queue is None or len(queue.waiting) < HIGH_WATER:
            return None
        if queue.room is None:
            queue.room = asyncio.get_running_loop().create_future()
        return queue.room

    def forget(self, source: bytes) -> None:
        """Drop what waits of a source that is gone; what has begun to leave is finished."""
        queue = self._queues.get(source)
        if queue is not None:
            queue.waiting.clear()
            self._release(queue)

    def abandon(self) -> None:
        """The stream broke: what had begun to leave is not begun again."""
        for queue in self._queues.values():
            queue.current = None

    def clear(self) -> None:
        """Drop everything: the stream is gone."""
        for queue in self._queues.values():
            self._release(queue)
        self._queues.clear()
        self._turns.clear()
        self._open = False

    def pause(self) -> None:
        self._open = False

    def resume(self) -> None:
        self._open = True
        self._pump()

    def _pump(self) -> None:
        while self._open and self._turns:
            source = self._turns[0]
            self._turns.rotate(-1)  # before anything that may raise or come back here
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
        if queue.room is not None and not queue.room.done():
            queue.room.set_result(None)
        queue.room = None
