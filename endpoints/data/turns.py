"""Turns of users at the event loop, so that the flood of one user delays nobody else's messages for long.

Received messages are processed in slices of time. What is left after a slice waits for its user's next turn. Each pass
of the loop gives turns, to all users in a circle, until a slice of time is over. So a pass takes about two slices. A
user's links and robots share the turns of that user.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict, deque
from collections.abc import Callable
from time import monotonic

SLICE = 0.0005  # seconds for which the messages of one link or robot may be processed at a stretch

Work = Callable[[], None]


class Turns:
    """Work that waits for a turn of its user."""

    def __init__(self) -> None:
        self._waiting: OrderedDict[str, deque[Work]] = OrderedDict()  # by user, whose turn is next first
        self._scheduled = False

    def busy(self, user: str) -> bool:
        """Return True if work of a user waits; new work of that user waits behind it."""
        return user in self._waiting

    def wait(self, user: str, work: Work) -> None:
        """Call `work` when its turn comes; it may wait for another one."""
        self._waiting.setdefault(user, deque()).append(work)
        self._schedule()

    def _schedule(self) -> None:
        if self._waiting and not self._scheduled:
            self._scheduled = True
            asyncio.get_running_loop().call_soon(self._give)

    def _give(self) -> None:
        end = monotonic() + SLICE
        try:
            while self._waiting:
                self._next()()
                if monotonic() > end:
                    break
        finally:  # also if the work has failed
            self._scheduled = False
            self._schedule()

    def _next(self) -> Work:
        """Return the next work, and put its user behind the others."""
        user, works = self._waiting.popitem(last=False)
        work = works.popleft()
        if works:
            self._waiting[user] = works
        return work
