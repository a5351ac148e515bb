"""Bounded queues in front of one stream, served round robin so that large messages do not delay small ones.

Each source (an interface) has its own queue. A message is a sequence of pieces, and the stream takes one piece from
each source in turn. So a velocity command waits for at most one piece of each image that is being sent. Sources of a
higher priority are served first. The messages of one source stay in order. The queue of a topic keeps the newest
messages and counts those that it drops; a queue without a bound makes its sender wait (`wait_for_room`). The bytes of
all queues of an owner are bounded too (`rce.net.budget`).
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterator
from enum import IntEnum
from typing import Generic, Protocol, TypeVar

from rce.net.budget import Budget

P = TypeVar("P")
HIGH_WATER = 8  # messages in an unbounded queue at which its sender must wait


class Priority(IntEnum):
    """Priority of a source: the lower number is served first."""

    HIGH = 0
    NORMAL = 1
    LOW = 2


class Owner(Protocol):
    """The owner of a queue, whose budget bounds its bytes."""

    budget: Budget

    def evicted(self, count: int) -> None:
        """Handle that this many messages were dropped from a queue, because a budget was exceeded."""


class _Queue(Generic[P]):
    """Queue of one source: the message that is being sent, and those that wait, each with its size.

    `bytes` is what the messages hold. The budget knows of `charged`: it is told only while messages have to wait, which
    costs nothing for those that are written at once.
    """

    __slots__ = (
        "bytes", "charged", "current", "current_size", "drained", "droppable", "drops", "owner", "priority", "waiting",
    )  # fmt: skip

    def __init__(self, owner: Owner | None, droppable: bool, priority: Priority) -> None:
        self.owner = owner
        self.droppable = droppable
        self.priority = priority
        self.current: Iterator[P] | None = None
        self.current_size = 0
        self.waiting: deque[tuple[Iterator[P], int]] = deque()
        self.drained: asyncio.Future[None] | None = None
        self.bytes = self.charged = 0
        self.drops = 0  # not reported yet

    @property
    def full(self) -> bool:
        """True if the sender has to wait until the queue is empty."""
        if len(self.waiting) >= HIGH_WATER:
            return True
        return bool(self.waiting) and self.owner is not None and self.owner.budget.full

    def begin_next(self) -> None:
        """Take the oldest message, to send it."""
        self.current, self.current_size = self.waiting.popleft()

    def end_current(self) -> None:
        """Forget the message that is being sent."""
        self.current = None
        self.bytes -= self.current_size
        self.current_size = 0
        if self.charged:
            self.settle()

    def drop_oldest(self, spare: int = 0) -> bool:
        """Drop the oldest message; return False if no more than `spare` messages wait."""
        if len(self.waiting) <= spare:
            return False
        self.bytes -= self.waiting.popleft()[1]
        self.drops += 1
        self.settle()
        return True

    def discard(self) -> None:
        """Drop all messages that wait."""
        self.bytes -= sum(size for _, size in self.waiting)
        self.waiting.clear()
        self.settle()
        self.release()

    def settle(self) -> None:
        """Tell the budget what the messages hold now."""
        if self.owner is not None and (change := self.bytes - self.charged):
            self.charged = self.bytes
            self.owner.budget.charge(self, change)

    def shrink(self) -> None:
        """Make the largest queues drop messages if a budget is exceeded, and tell the owners of the others."""
        self.settle()
        if self.owner is None:
            return
        for queue in self.owner.budget.shrink():
            if isinstance(queue, _Queue) and queue is not self:
                queue.report()

    def report(self) -> None:
        """Tell the owner of the messages that were dropped."""
        if self.owner is not None:
            self.owner.evicted(self.take_drops())

    def take_drops(self) -> int:
        """Return the number of drops that were not reported yet."""
        drops, self.drops = self.drops, 0
        return drops

    def release(self) -> None:
        """Let the sender continue."""
        if self.drained is not None and not self.drained.done():
            self.drained.set_result(None)
        self.drained = None


def _closed(_: object) -> bool:
    return False


class Outbox(Generic[P]):
    """Queues of all sources of one stream.

    `write` writes a piece to the stream and returns True if the stream has room for another.
    """

    def __init__(self, write: Callable[[P], bool]) -> None:
        self._write = write
        self._queues: dict[bytes, _Queue[P]] = {}
        self._turns: tuple[list[bytes], ...] = tuple([] for _ in Priority)  # an empty deque is ten times as large
        self._open = True

    def put(
        self,
        source: bytes,
        pieces: Iterator[P],
        keep: int | None,
        size: int = 0,
        owner: Owner | None = None,
        priority: Priority = Priority.NORMAL,
    ) -> int:
        """Queue a message. After `clear` it is dropped.

        Args:
            source: Source of the message.
            pieces: The pieces of the message.
            keep: Number of messages of the source that may wait, the newest; None for all.
            size: Bytes that the message holds while it waits.
            owner: Owner of the source, whose budget bounds these bytes.
            priority: Priority of the source.

        Returns:
            The number of older messages of the source that were dropped.
        """
        begun = self._open and not self._queues
        if begun and self._write_all(pieces):
            if self._queues:  # filled meanwhile
                self._pump()
            return 0
        if self._write is _closed:
            return 0
        queue = self._queues.get(source)
        if queue is None:
            queue = self._queues[source] = _Queue(owner, keep is not None, priority)
            self._turns[priority].append(source)
        if begun:
            queue.current, queue.current_size = pieces, size
        else:
            queue.waiting.append((pieces, size))
        queue.bytes += size
        if self._open:
            self._pump()
        elif keep is not None:
            while queue.drop_oldest(keep):
                pass
        if queue.bytes != queue.charged:  # it has to wait
            queue.shrink()
        return queue.take_drops() if queue.drops else 0

    def _write_all(self, pieces: Iterator[P]) -> bool:
        """Write a message, before which nothing waits; return False if the stream is full before its end.

        Most messages are written at once, and need no queue.
        """
        has_room = True
        self._open = False  # what the calls below put waits
        try:
            while has_room:
                piece = next(pieces, None)
                if piece is None:
                    return True
                has_room = self._write(piece)
            return False
        finally:
            self._open = has_room

    @property
    def empty(self) -> bool:
        """True if all messages were written to the stream."""
        return not self._queues

    @property
    def idle(self) -> bool:
        """True if nothing waits and the stream has room."""
        return self._open and not self._queues

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
        if queue is None or not queue.full:
            return None
        if queue.drained is None:
            queue.drained = asyncio.get_running_loop().create_future()
        return queue.drained

    def discard(self, source: bytes) -> None:
        """Drop the waiting messages of `source`; one that is being sent is completed."""
        queue = self._queues.get(source)
        if queue is not None:
            queue.discard()

    def abort_current(self) -> None:
        """Drop the messages that are being sent, because the stream broke."""
        for queue in self._queues.values():
            queue.end_current()

    def clear(self) -> None:
        """Drop all messages, and those that follow, because the stream is gone."""
        for queue in self._queues.values():
            queue.end_current()
            queue.discard()
        self._queues.clear()
        for turns in self._turns:
            turns.clear()
        self._open = False
        self._write = _closed  # break the reference cycle with the owner, whose method this usually is

    def pause(self) -> None:
        """Stop writing to the stream."""
        self._open = False

    def resume(self) -> None:
        """Write to the stream until it is full."""
        self._open = True
        self._pump()

    def _pump(self) -> None:
        while self._open and self._queues:
            turns = next(filter(None, self._turns))
            source = turns.pop(0)
            turns.append(source)  # first, because the calls below may raise or call `put`
            queue = self._queues[source]
            if queue.current is None and queue.waiting:
                queue.begin_next()
            piece = next(queue.current, None) if queue.current is not None else None
            if piece is not None:
                self._open = self._write(piece)
                continue
            queue.end_current()
            if not queue.waiting:
                turns.remove(source)
                del self._queues[source]
                queue.release()
