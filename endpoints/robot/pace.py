"""Pace of a topic for one receiver: at most one message in an interval, before any is converted.

Intervals begin at the same times for all receivers, at multiples of their length. So receivers at the same rate get the
same messages, each of which is converted once for all of them.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Callable

from endpoints.data.frames import Message
from rce.net.budget import OVERHEAD, Budget

EARLY = 0.05  # intervals
SHORTEST = 0.001  # seconds; a shorter interval is none


class Pace:
    """Pace of messages.

    Args:
        interval: Seconds in which one message passes.
        length: Number of messages that wait for their turn, the newest; with 0 those that come too early are dropped.
        budget: Bytes that the messages which wait may hold; while it is exceeded, only one of them waits.
    """

    droppable = True

    def __init__(self, interval: float, length: int, budget: Budget) -> None:
        self.charged = 0
        self._interval = interval
        self._length = length
        self._budget = budget
        self._waiting: deque[tuple[Message, Callable[[Message], None]]] = deque()
        self._next = 0.0  # time of the loop from which a message may pass
        self._timer: asyncio.TimerHandle | None = None

    def admits(self, message: Message, deliver: Callable[[Message], None]) -> bool:
        """Return True if a message may pass now; one that waits is delivered later."""
        loop = asyncio.get_running_loop()
        now = loop.time()
        if now >= self._next and not self._waiting:
            self._next = self._end_of_interval(now)
            return True
        if self._length:
            self._waiting.append((message, deliver))
            self._charge(len(message.payload) + OVERHEAD)
            while (len(self._waiting) > self._length or self._budget.full) and self.drop_oldest(1):
                pass
            if self._timer is None:
                self._timer = loop.call_at(self._next, self._deliver)
        return False

    def follow(self, earlier: Pace) -> None:
        """Let no message pass until the end of the earlier pace's interval, or of this one's if that comes first."""
        self._next = min(earlier._next, self._end_of_interval(asyncio.get_running_loop().time()))

    def drop_oldest(self, spare: int) -> bool:
        """Drop the oldest message; return False if no more than `spare` messages wait."""
        if len(self._waiting) <= spare:
            return False
        self._take()
        return True

    def close(self) -> None:
        """Drop the messages that wait."""
        while self.drop_oldest(0):
            pass
        if self._timer is not None:
            self._timer.cancel()

    def _end_of_interval(self, now: float) -> float:
        """Return the end of the interval in which a time lies; a timer that is a little early is in the next one."""
        return (math.floor(now / self._interval + EARLY) + 1) * self._interval

    def _charge(self, amount: int) -> None:
        self.charged += amount
        self._budget.charge(self, amount)

    def _take(self) -> tuple[Message, Callable[[Message], None]]:
        taken = self._waiting.popleft()
        self._charge(-len(taken[0].payload) - OVERHEAD)
        return taken

    def _deliver(self) -> None:
        self._timer = None
        if not self._waiting:  # dropped, because a larger budget was exceeded
            return
        loop = asyncio.get_running_loop()
        message, deliver = self._take()
        self._next = self._end_of_interval(loop.time())
        if self._waiting:
            self._timer = loop.call_at(self._next, self._deliver)
        deliver(message)
