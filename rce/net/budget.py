"""Budgets in bytes for messages that wait in queues: of an interface, its session, its user and the process.

Each budget is part of a larger one. When a budget is exceeded, the largest queue in it drops its oldest messages. So a
receiver that does not read costs others nothing, whatever number and size of messages it asked for.
"""

from __future__ import annotations

from typing import Protocol

MB = 1024 * 1024
INTERFACE = 16 * MB  # bytes that the messages of one interface may hold, besides the newest one
OVERHEAD = 512  # bytes that a waiting message takes besides its payload
SLACK = 32  # part of a budget that is freed at a time, so that the largest queue is not searched for each message


class Holder(Protocol):
    """A queue as its budget sees it."""

    charged: int
    droppable: bool

    def drop_oldest(self, spare: int) -> bool:
        """Drop the oldest message and charge less; return False if no more than `spare` messages wait."""


class Budget:
    """Bytes that the queues of an interface, a session, a user or a process may hold together.

    Attributes:
        used: Bytes that they hold now.
    """

    def __init__(self, limit: int, parent: Budget | None = None, spare: int = 0) -> None:
        """Create an empty budget.

        Args:
            limit: Bytes.
            parent: The budget that this one is a part of.
            spare: Number of messages of each queue that are kept although the budget is exceeded.
        """
        self.used = 0
        self._limit = limit
        self._spare = spare
        # Without this budget itself: with such a reference cycle it would wait for the garbage collector.
        self._above: tuple[Budget, ...] = (parent, *parent._above) if parent is not None else ()
        self._holders: dict[Holder, None] = {}  # a third of the size of an empty set

    @property
    def full(self) -> bool:
        """True if this budget, or one that it is a part of, is used up."""
        return any(level.used >= level._limit for level in (self, *self._above))

    def charge(self, holder: Holder, amount: int) -> None:
        """Add to the bytes of a queue, whose `charged` includes `amount` already; a negative amount frees bytes."""
        for level in (self, *self._above):
            level.used += amount
            if holder.charged:
                level._holders[holder] = None
            else:
                level._holders.pop(holder, None)

    def shrink(self) -> set[Holder]:
        """Make the largest queues of every budget that is exceeded drop messages; return the queues that did."""
        shrunk: set[Holder] = set()
        for level in (self, *self._above):
            if level.used > level._limit:
                shrunk |= level._drop()
        return shrunk

    def _drop(self) -> set[Holder]:
        goal = self._limit if self._spare else self._limit - self._limit // SLACK
        shrunk: set[Holder] = set()
        # Queues that must not drop make their senders wait instead; if that does not suffice, they have to drop too.
        candidates = {each for each in self._holders if each.droppable or self.used > 2 * self._limit}
        while self.used > goal and candidates:
            largest = max(candidates, key=lambda each: each.charged)
            half = largest.charged // 2
            while self.used > goal and largest.charged > half:
                if not largest.drop_oldest(self._spare):
                    candidates.discard(largest)
                    break
                shrunk.add(largest)
        return shrunk
